#include "visual_frontend/pose_solver.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <limits>

#include "air_ground_common/linear_algebra.h"
#include "synthetic.h"

namespace visual_frontend {
namespace {

using synthetic::Random;

PoseCorrespondence correspondence(Random& random, const Pose& T_map_camera, double sigma) {
  PoseCorrespondence c;
  c.p_map = synthetic::visiblePoint(random, T_map_camera);
  const Eigen::Vector3d p = T_map_camera.inverse() * c.p_map;
  c.normalized = p.head<2>() / p.z() + Eigen::Vector2d(random.gauss(sigma), random.gauss(sigma));
  c.sigma = std::max(sigma, 1e-4);
  return c;
}

std::vector<PoseCorrespondence> scene(Random& random, const Pose& T, int good, int bad, double sigma) {
  std::vector<PoseCorrespondence> c;
  for (int i = 0; i < good + bad; ++i) {
    c.push_back(correspondence(random, T, sigma));
    if (i >= good) c.back().normalized = {random.uniform(-0.6, 0.6), random.uniform(-0.45, 0.45)};
  }
  return c;
}

double positionError(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).norm(); }

TEST(P2P, ExactForRandomPoses) {
  Random random(1);
  for (int i = 0; i < 500; ++i) {
    const Pose T = synthetic::randomPose(random);
    const Eigen::Vector3d p0 = synthetic::visiblePoint(random, T), p1 = synthetic::visiblePoint(random, T);
    const Eigen::Vector3d r0 = T.inverse() * p0, r1 = T.inverse() * p1;
    if (r0.normalized().cross(r1.normalized()).norm() < 0.02) continue;
    const auto centre = solveP2P(T.linear(), p0, 2.3 * r0, p1, r1);
    ASSERT_TRUE(centre);
    EXPECT_LT((*centre - T.translation()).norm(), 1e-9);
    // The inverse rotation is another problem: a wrong convention must not pass.
    const auto wrong = solveP2P(T.linear().transpose(), p0, r0, p1, r1);
    const bool turned = air_ground_common::logSO3(T.linear()).norm() > 0.2;
    EXPECT_FALSE(wrong && turned && (*wrong - T.translation()).norm() < 1e-3);
  }
}

TEST(P2P, RefusesParallelRaysAndPointsBehind) {
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  EXPECT_FALSE(solveP2P(I, {0, 0, 2}, {0, 0, 1}, {1, 0, 2}, {0, 0, 1}));
  // Points swapped left and right: the rays meet behind.
  EXPECT_FALSE(solveP2P(I, {-0.5, 0, 2}, {0.5, 0, 1}, {0.5, 0, 2}, {-0.5, 0, 1}));
}

TEST(P3P, OneSolutionIsTheTruth) {
  Random random(2);
  int solved = 0, tried = 0;
  for (int i = 0; i < 2000; ++i) {
    const Pose T = synthetic::randomPose(random);
    Eigen::Matrix3d points, rays;
    for (int k = 0; k < 3; ++k) {
      points.col(k) = synthetic::visiblePoint(random, T);
      rays.col(k) = random.uniform(0.5, 2) * (T.inverse() * points.col(k));
    }
    Eigen::Matrix3d unit = rays.colwise().normalized();
    if (std::abs(unit.determinant()) < 1e-3) continue;  // nearly in one plane with the camera
    ++tried;
    const auto poses = solveP3P(points, rays);
    EXPECT_LE(poses.size(), 4u);
    double best = 1e9;
    for (const Pose& pose : poses) {
      EXPECT_TRUE(air_ground_common::isValid(pose));
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector3d p = pose.inverse() * points.col(k);
        EXPECT_LT(p.normalized().cross(unit.col(k)).norm(), 1e-5);
        EXPECT_GT(p.dot(unit.col(k)), 0);
      }
      best = std::min(best, positionError(pose, T));
    }
    solved += best < 1e-5;
  }
  EXPECT_GT(tried, 1800);
  EXPECT_GE(solved, tried * 0.998);
}

TEST(P3P, DegenerateTrianglesGiveNothingWrong) {
  Eigen::Matrix3d points, rays;
  points << 0, 1, 2, 0, 0, 0, 3, 3, 3;  // on a line
  rays = points;
  EXPECT_TRUE(solveP3P(points, rays).empty());
  points.setZero();
  EXPECT_TRUE(solveP3P(points, rays).empty());
}

class RansacTest : public testing::TestWithParam<std::tuple<double, double>> {};

TEST_P(RansacTest, FindsPoseDespiteOutliersAndNoise) {
  const auto [outliers, pixels] = GetParam();
  const double sigma = std::max(pixels, 0.05) / 525;
  Random random(3);
  for (int trial = 0; trial < 10; ++trial) {
    const Pose T = synthetic::randomPose(random);
    const auto c = scene(random, T, static_cast<int>(120 * (1 - outliers)), static_cast<int>(120 * outliers), sigma);
    RansacSettings settings;
    settings.seed = trial;
    const PoseResult p3p = ransacPose(c, settings);
    ASSERT_TRUE(p3p.success) << p3p.reason;
    RefineSettings refine;
    const PoseResult full = refinePose(c, p3p.T_map_camera, refine);
    ASSERT_TRUE(full.success) << full.reason;
    EXPECT_LT(positionError(full.T_map_camera, T), 1e-3 + 0.012 * pixels);
    EXPECT_LT(air_ground_common::rotationAngle(full.T_map_camera.linear(), T.linear()), 1e-3 + 3e-3 * pixels);

    // Rotation from a gyro: a milliradian off.
    const Eigen::Matrix3d R = T.linear() * air_ground_common::expSO3(random.gaussVector(0.0005));
    RansacSettings two = settings;
    two.threshold = 3 + 0.6 / std::max(pixels, 0.05);
    const PoseResult p2p = ransacKnownRotation(c, R, two);
    ASSERT_TRUE(p2p.success) << p2p.reason;
    EXPECT_LE(p2p.iterations, p3p.iterations + 30);
    const PoseResult refined = refinePose(c, p2p.T_map_camera, refine);
    ASSERT_TRUE(refined.success);
    EXPECT_LT(positionError(refined.T_map_camera, full.T_map_camera), 1e-3 + 0.005 * pixels);
    int wrong = 0;
    for (std::size_t i = 120 * (1 - outliers); i < c.size(); ++i) wrong += full.inliers[i];
    EXPECT_LE(wrong, 2);
  }
}
INSTANTIATE_TEST_SUITE_P(Sweep, RansacTest,
                         testing::Combine(testing::Values(0.0, 0.3, 0.5), testing::Values(0.0, 0.5, 1.5)));

TEST(Ransac, WhatIsNoNumberIsNoInlier) {
  Random random(8);
  const Pose T = synthetic::randomPose(random);
  auto c = scene(random, T, 45, 0, 0);
  for (std::size_t i = 40; i < c.size(); ++i) c[i].normalized.y() = std::numeric_limits<double>::quiet_NaN();
  for (const PoseResult& r : {ransacPose(c, {}), ransacKnownRotation(c, T.linear(), {})}) {
    ASSERT_TRUE(r.success) << r.reason;
    EXPECT_EQ(r.inlier_count, 40);
    EXPECT_EQ(std::count(r.inliers.begin() + 40, r.inliers.end(), 0), 5);
    EXPECT_LT(r.rms, 0.1);
    EXPECT_LT(positionError(r.T_map_camera, T), 1e-3);
  }
}

TEST(Ransac, SaysWhyItFails) {
  Random random(4);
  const Pose T = synthetic::randomPose(random);
  EXPECT_FALSE(ransacPose({}, {}).success);
  EXPECT_FALSE(ransacKnownRotation({}, Eigen::Matrix3d::Identity(), {}).success);
  const PoseResult noise = ransacPose(scene(random, T, 0, 60, 1e-3), {});
  EXPECT_FALSE(noise.success);
  EXPECT_FALSE(noise.reason.empty());
}

TEST(Refine, CovarianceIsConsistent) {
  // Normalised estimation error squared over many trials: its mean is 6 for an honest covariance.
  Random random(5);
  double nees = 0, nees_depth = 0;
  constexpr int kTrials = 400;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Pose T = synthetic::randomPose(random);
    auto c = scene(random, T, 60, 0, 0.8 / 525);
    for (const bool depth : {false, true}) {
      if (depth) {
        for (auto& x : c) {
          const double z = (T.inverse() * x.p_map).z();
          x.depth_sigma = 0.003 * z * z;
          x.depth = z + random.gauss(x.depth_sigma);
        }
      }
      RefineSettings settings;
      settings.loss = RobustLoss::kNone;
      settings.inlier_threshold = 6;
      Pose start = T;
      start.translation() += random.gaussVector(0.05);
      start.linear() = air_ground_common::expSO3(random.gaussVector(0.02)) * start.linear();
      const PoseResult r = refinePose(c, start, settings);
      ASSERT_TRUE(r.success);
      Vector6d e;
      e.head<3>() = r.T_map_camera.translation() - T.translation();
      e.tail<3>() = air_ground_common::logSO3(r.T_map_camera.linear() * T.linear().transpose());
      (depth ? nees_depth : nees) += air_ground_common::squaredMahalanobis(e, r.covariance);
    }
  }
  // The covariance is scaled up by chi^2 when that exceeds its expectation, so the mean lies a little below 6.
  EXPECT_NEAR(nees / kTrials, 5.7, 0.6);
  EXPECT_NEAR(nees_depth / kTrials, 5.7, 0.6);
}

TEST(Refine, PriorsPullTheRightWay) {
  Random random(6);
  const Pose T = synthetic::randomPose(random);
  const auto c = scene(random, T, 6, 0, 5.0 / 525);
  RefineSettings settings;
  settings.inlier_threshold = 10;
  const PoseResult free = refinePose(c, T, settings);
  settings.R_map_camera_prior = T.linear();
  settings.rotation_prior_sigma = 1e-4;
  const PoseResult held = refinePose(c, T, settings);
  ASSERT_TRUE(free.success && held.success);
  EXPECT_LT(air_ground_common::rotationAngle(held.T_map_camera.linear(), T.linear()), 5e-4);
  EXPECT_GT(air_ground_common::rotationAngle(free.T_map_camera.linear(), T.linear()), 2e-3);
  settings.R_map_camera_prior.reset();
  settings.up_camera = T.linear().transpose() * Eigen::Vector3d::UnitZ();
  settings.up_sigma = 1e-4;
  const PoseResult level = refinePose(c, T, settings);
  ASSERT_TRUE(level.success);
  EXPECT_LT((level.T_map_camera.linear().transpose().col(2) - *settings.up_camera).norm(), 5e-4);
}

// Most points move together, and not with the camera: those that were chosen keep the pose from being dragged along.
TEST(Refine, GoesByThePointsThatWereChosen) {
  Random random(10);
  int dragged = 0;
  for (int trial = 0; trial < 20; ++trial) {
    const Pose T = synthetic::randomPose(random);
    auto c = scene(random, T, 200, 0, 0.8 / 525);
    const Eigen::Vector3d step = T.linear() * Eigen::Vector3d(0.15, 0.05, 0);
    std::vector<unsigned char> chosen(c.size(), 0);
    for (std::size_t i = 0; i < c.size(); ++i) {
      chosen[i] = i % 20 < 9;
      if (!chosen[i]) c[i].p_map += step;
    }
    const PoseResult r = refinePose(c, T, {}, chosen);
    ASSERT_TRUE(r.success);
    EXPECT_LT(positionError(r.T_map_camera, T), 0.02) << trial;
    dragged += positionError(refinePose(c, T, {}).T_map_camera, T) > 0.03;
  }
  EXPECT_GT(dragged, 15) << "without";
}

TEST(Refine, FailsHonestly) {
  Random random(7);
  const Pose T = synthetic::randomPose(random);
  EXPECT_FALSE(refinePose(scene(random, T, 2, 0, 1e-3), T, {}).success);
  // All points on one line of sight cannot fix a pose.
  std::vector<PoseCorrespondence> line(10);
  for (int i = 0; i < 10; ++i) line[i].p_map = T * Eigen::Vector3d(0, 0, 1 + i);
  const PoseResult r = refinePose(line, T, {});
  EXPECT_FALSE(r.success);
  EXPECT_FALSE(r.reason.empty());
  Pose bad = T;
  bad.translation().x() = NAN;
  EXPECT_FALSE(refinePose(scene(random, T, 20, 0, 1e-3), bad, {}).success);
}

TEST(TranslationDirection, SignAndDirectionWithOutliers) {
  Random random(8);
  for (int trial = 0; trial < 30; ++trial) {
    const Pose T_map_a = synthetic::randomPose(random);
    Pose T_a_b = Pose::Identity();
    T_a_b.translation() = random.vector(0.5);
    T_a_b.linear() = air_ground_common::expSO3(random.vector(0.2));
    std::vector<Eigen::Vector2d> a, b;
    const double sigma = 0.5 / 525;
    for (int i = 0; i < 150; ++i) {
      const Eigen::Vector3d p_a = T_map_a.inverse() * synthetic::visiblePoint(random, T_map_a);
      const Eigen::Vector3d p_b = T_a_b.inverse() * p_a;
      if (p_b.z() < 0.2) continue;
      a.push_back(p_a.head<2>() / p_a.z() + Eigen::Vector2d(random.gauss(sigma), random.gauss(sigma)));
      b.push_back(p_b.head<2>() / p_b.z() + Eigen::Vector2d(random.gauss(sigma), random.gauss(sigma)));
      if (i % 4 == 0) b.back() += Eigen::Vector2d(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2));
    }
    const auto result = translationFromKnownRotation(a, b, T_a_b.linear(), sigma, {});
    ASSERT_TRUE(result.success) << result.reason;
    const double angle = std::acos(std::min(1.0, result.t_a_b.dot(T_a_b.translation().normalized())));
    EXPECT_LT(angle, 0.06) << "baseline " << T_a_b.translation().norm();
    EXPECT_GT(result.median_parallax, 0.005);
  }
}

TEST(TranslationDirection, NoMotionHasNoParallax) {
  Random random(9);
  std::vector<Eigen::Vector2d> a;
  for (int i = 0; i < 50; ++i) a.emplace_back(random.uniform(-0.5, 0.5), random.uniform(-0.4, 0.4));
  const auto result = translationFromKnownRotation(a, a, Eigen::Matrix3d::Identity(), 1e-3, {});
  EXPECT_TRUE(!result.success || result.median_parallax < 1e-6);
}

TEST(TranslationDirection, WhatIsNoNumberHasNoParallax) {
  Random random(11);
  std::vector<Eigen::Vector2d> a, b;
  for (int i = 0; i < 85; ++i) {
    const Eigen::Vector3d p(random.uniform(-1, 1), random.uniform(-1, 1), 3);
    a.push_back(p.hnormalized());
    b.push_back((p - Eigen::Vector3d(0.15, 0, 0)).eval().hnormalized());
    if (i >= 40) b.back().y() = std::numeric_limits<double>::quiet_NaN();
  }
  const auto result = translationFromKnownRotation(a, b, Eigen::Matrix3d::Identity(), 1e-3, {});
  ASSERT_TRUE(result.success) << result.reason;
  EXPECT_EQ(result.inlier_count, 40);
  EXPECT_GT(result.t_a_b.x(), 0.99);
  EXPECT_NEAR(result.median_parallax, 0.05, 0.01);  // 0.15 m at 3 m
}

}  // namespace
}  // namespace visual_frontend
