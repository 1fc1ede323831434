#include <gtest/gtest.h>

#include "mav_vo/bootstrap.h"
#include "synthetic_flight.h"
#include "visual_frontend/pose_solver.h"

using namespace mav_vo;
using synthetic::Pose;
using visual_frontend::Feature;

namespace {

struct Scene {
  explicit Scene(unsigned seed, bool flat = false) : random(seed) {
    points = synthetic::pointCloud(3000, random);
    if (flat)
      for (auto& p : points) p.z() = 0;
  }

  std::vector<Feature> view(const Pose& T_world_camera, double pixel_noise, double outlier_share = 0) {
    std::normal_distribution<double> normal(0, pixel_noise);
    std::uniform_real_distribution<double> unit(0, 1);
    std::vector<Feature> features;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto pixel = camera.project(T_world_camera.inverse() * points[i]);
      if (!pixel || !camera.contains(*pixel, 5)) continue;
      Feature f;
      f.id = static_cast<visual_frontend::TrackId>(i);
      f.pixel = *pixel + Eigen::Vector2d(normal(random), normal(random));
      if (unit(random) < outlier_share) f.pixel += Eigen::Vector2d(25 * unit(random) + 5, -20 * unit(random) - 5);
      f.normalized = camera.unproject(f.pixel);
      features.push_back(f);
    }
    return features;
  }

  std::mt19937 random;
  std::vector<Eigen::Vector3d> points;
  air_ground_common::CameraModel camera = synthetic::camera();
};

/// Feeds the flight from 2.5 s on; the first result and the true pose of its last view in its first.
std::optional<BootstrapResult> start(Scene& scene, bool gyro, double outlier_share, Pose* T_truth,
                                     double gyro_noise = 0, double gyro_bias_sigma = 0) {
  const synthetic::Flight flight;
  Bootstrap bootstrap(scene.camera, BootstrapSettings{});
  std::normal_distribution<double> normal(0, gyro_noise);
  const auto at = [&](double t) { return flight.T_world_imu(t) * synthetic::T_imu_camera(); };
  const GyroRotations rotations = [&](double a, double b) {
    const double noise = std::sqrt((b - a) / 0.05);
    return GyroRotation{
        at(a).linear().transpose() * at(b).linear() *
            air_ground_common::expSO3(
                noise * Eigen::Vector3d(normal(scene.random), normal(scene.random), normal(scene.random))),
        gyro_bias_sigma * (b - a)};
  };
  for (int i = 0; i < 80; ++i) {
    const double t = 2.5 + 0.05 * i;
    auto result = bootstrap.add(t, scene.view(at(t), 0.4, outlier_share), {}, gyro ? rotations : GyroRotations{});
    if (!result) continue;
    *T_truth = at(result->views.front().stamp).inverse() * at(result->views.back().stamp);
    return result;
  }
  ADD_FAILURE() << bootstrap.reason();
  return std::nullopt;
}

void expectRight(const BootstrapResult& result, const Pose& T_truth, Scene& scene, double angle) {
  const Pose& T = result.views.back().T_first_camera;
  EXPECT_LT(air_ground_common::rotationAngle(T.linear(), T_truth.linear()), 0.01);
  // The sign matters: the mirrored translation puts all points behind the cameras.
  EXPECT_LT(std::acos(std::min(1.0, T.translation().normalized().dot(T_truth.translation().normalized()))), angle);
  const double unit = T.translation().norm() / T_truth.translation().norm();
  const synthetic::Flight flight;
  const Pose first = flight.T_world_imu(result.views.front().stamp) * synthetic::T_imu_camera();
  std::vector<double> errors;
  for (const auto& point : result.points) {
    const Eigen::Vector3d truth = first.inverse() * scene.points[static_cast<std::size_t>(point.track)];
    errors.push_back((point.position / unit - truth).norm() / truth.z());
  }
  ASSERT_GE(errors.size(), 22u);
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.03);
  EXPECT_LT(errors[errors.size() * 9 / 10], 0.10);
}

TEST(Bootstrap, TwoPointsWithGyro) {
  Scene scene(1);
  Pose T_truth;
  const auto result = start(scene, true, 0.0, &T_truth);
  ASSERT_TRUE(result);
  EXPECT_TRUE(result->rotation_from_gyro);
  EXPECT_GE(result->views.size(), 2u);
  expectRight(*result, T_truth, scene, 0.03);
}

TEST(Bootstrap, SurvivesOutliersAndGyroNoise) {
  for (unsigned seed = 2; seed < 7; ++seed) {
    Scene scene(seed);
    Pose T_truth;
    const auto result = start(scene, true, 0.05, &T_truth, 2e-4);
    ASSERT_TRUE(result) << "seed " << seed;
    expectRight(*result, T_truth, scene, 0.06);
  }
}

TEST(Bootstrap, FlatFloorHasOneSolutionWithGyro) {
  Scene scene(3, true);
  Pose T_truth;
  const auto result = start(scene, true, 0.0, &T_truth);
  ASSERT_TRUE(result);
  expectRight(*result, T_truth, scene, 0.03);
}

// A drone that turns on the spot, its rows read within 25 ms, which nobody told; no gyro.
TEST(Bootstrap, ATurnUnderARollingShutterIsNoMotion) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Scene scene(seed);
    Bootstrap bootstrap(scene.camera, BootstrapSettings{});
    bool told = false;
    const auto at = [](double t) {
      Pose T = synthetic::Flight().T_world_imu(2.5) * synthetic::T_imu_camera();
      T.linear() *= air_ground_common::expSO3(0.3 * Eigen::Vector3d(std::sin(2 * t), 1 - std::cos(1.7 * t), 0));
      return T;
    };
    for (double t = 0; t < 6; t += 0.05) {
      std::vector<Feature> features = scene.view(at(t), 0);
      for (Feature& f : features) {
        const Eigen::Vector3d& p = scene.points[static_cast<std::size_t>(f.id)];
        for (int round = 0; round < 3; ++round)
          f.pixel =
              scene.camera.project(at(t + 0.025 * ((f.pixel.y() + 0.5) / scene.camera.height - 0.5)).inverse() * p)
                  .value_or(f.pixel);
        std::normal_distribution<double> noise(0, 0.3);
        f.pixel += Eigen::Vector2d(noise(scene.random), noise(scene.random));
        f.normalized = scene.camera.unproject(f.pixel);
      }
      const auto result = bootstrap.add(t, features, {}, {});
      told = told || bootstrap.reason().find("turn rather than move") != std::string::npos;
      ASSERT_FALSE(result) << "seed " << seed << ", " << t << " s: parallax " << result->median_parallax;
    }
    EXPECT_TRUE(told) << "seed " << seed;
  }
}

TEST(Bootstrap, FivePointsWithoutGyro) {
  Scene scene(4);
  Pose T_truth;
  const auto result = start(scene, false, 0.05, &T_truth);
  ASSERT_TRUE(result);
  EXPECT_FALSE(result->rotation_from_gyro);
  expectRight(*result, T_truth, scene, 0.06);
}

TEST(Bootstrap, WaitsDuringPureRotation) {
  Scene scene(5);
  Bootstrap bootstrap(scene.camera, BootstrapSettings{});
  const Pose T = synthetic::Flight{}.T_world_imu(6.0) * synthetic::T_imu_camera();
  for (const bool gyro : {true, false}) {
    bootstrap.reset();
    for (int i = 0; i < 40; ++i) {
      Pose turned = T;
      turned.linear() = T.linear() * air_ground_common::expSO3({0.01 * i, 0.004 * i, 0});
      const GyroRotations rotations = [](double a, double b) {
        return GyroRotation{air_ground_common::expSO3({0.2 * a, 0.08 * a, 0}).transpose() *
                                air_ground_common::expSO3({0.2 * b, 0.08 * b, 0}),
                            0};
      };
      EXPECT_FALSE(bootstrap.add(0.05 * i, scene.view(turned, 0.4), {}, gyro ? rotations : GyroRotations{}))
          << (gyro ? "with" : "without") << " gyro, image " << i;
    }
    EXPECT_FALSE(bootstrap.reason().empty());
  }
}

TEST(Bootstrap, WaitsWithoutFeatures) {
  Scene scene(6);
  Bootstrap bootstrap(scene.camera, BootstrapSettings{});
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(bootstrap.add(0.05 * i, {}, {}, GyroRotations{}));
  EXPECT_NE(bootstrap.reason().find("too few"), std::string::npos);
}

// The gyro's bias is known so poorly that a turn over five seconds is not, of a camera that has hovered for eight.
TEST(Bootstrap, BeginsWithYoungerViewsWhereTheGyroLeavesOldOnesOpen) {
  Scene scene(8);
  Bootstrap bootstrap(scene.camera, BootstrapSettings{});
  const Pose hover = synthetic::Flight{}.T_world_imu(6.0) * synthetic::T_imu_camera();
  const GyroRotations rotations = [](double a, double b) {
    return GyroRotation{Eigen::Matrix3d::Identity(), 0.0042 * (b - a)};
  };
  for (int i = 0; i < 200; ++i) {
    const double t = 0.05 * i;
    Pose T = hover;
    T.translation() += hover.linear() * Eigen::Vector3d(0.1 * std::max(0.0, t - 8), 0, 0);
    if (const auto result = bootstrap.add(t, scene.view(T, 0.4), {}, rotations)) {
      EXPECT_GT(result->views.back().stamp, 8);
      return;
    }
  }
  ADD_FAILURE() << bootstrap.reason();
}

// Tracks three times as noisy as believed: many points come out uncertain.
TEST(Bootstrap, SaysWhatToDoWhereTooFewPointsAreSure) {
  const synthetic::Flight flight;
  const auto at = [&](double t) { return flight.T_world_imu(t) * synthetic::T_imu_camera(); };
  std::string reasons;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    Scene scene(seed);
    Bootstrap bootstrap(scene.camera, BootstrapSettings{});
    for (int i = 0; i < 40; ++i) {
      const double t = 2.5 + 0.05 * i;
      if (bootstrap.add(t, scene.view(at(t), 1.8), {}, [&](double a, double b) {
            return GyroRotation{at(a).linear().transpose() * at(b).linear(), 0};
          }))
        break;
      reasons += bootstrap.reason() + "\n";
    }
  }
  EXPECT_NE(reasons.find("points of the first views have a sure depth"), std::string::npos) << reasons;
  EXPECT_NE(reasons.find("go on moving sideways"), std::string::npos) << reasons;
}

// The two-point solver of the shared front end against OpenGV's five-point solution and the truth.
TEST(TwoPoint, AgreesWithTruthAndFivePoints) {
  Scene scene(7);
  const synthetic::Flight flight;
  const double sigma = 0.4 / scene.camera.fx;
  for (const double t : {3.0, 5.0, 8.0}) {
    const Pose a = flight.T_world_imu(t) * synthetic::T_imu_camera(),
               b = flight.T_world_imu(t + 0.6) * synthetic::T_imu_camera();
    std::vector<Eigen::Vector2d> xa, xb;
    const auto view_a = scene.view(a, 0.4), view_b = scene.view(b, 0.4);
    for (const auto& f : view_a)
      for (const auto& g : view_b)
        if (f.id == g.id) {
          xa.push_back(f.normalized);
          xb.push_back(g.normalized);
        }
    const Pose T = a.inverse() * b;
    const auto two =
        visual_frontend::translationFromKnownRotation(xa, xb, T.linear(), sigma, visual_frontend::RansacSettings{});
    std::vector<unsigned char> inliers;
    const auto five = fivePointPose(xa, xb, sigma, &inliers);
    ASSERT_TRUE(two.success) << two.reason;
    ASSERT_TRUE(five);
    const Eigen::Vector3d truth = T.translation().normalized();
    EXPECT_GT(two.t_a_b.dot(truth), std::cos(0.02));
    EXPECT_GT(five->translation().dot(truth), std::cos(0.12));
    // Knowing the rotation can only help.
    EXPECT_LT(std::acos(std::min(1.0, two.t_a_b.dot(truth))),
              std::acos(std::min(1.0, five->translation().dot(truth))) + 0.01);
  }
}

}  // namespace
