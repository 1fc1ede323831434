// Points seen by several views, fused with a wrong model: against exact geometry, and against the spread of the errors.
#include "streetview_localizer/point_fusion.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <random>

namespace streetview_localizer {
namespace {

constexpr double kFocal = 500;

CameraModel camera() {
  CameraModel c;
  c.width = 800;
  c.height = 600;
  c.fx = c.fy = kFocal;
  c.cx = 399.5;
  c.cy = 299.5;
  return c;
}

// Camera at `position` that looks along +y, x of the image towards +x.
Pose lookNorth(const Eigen::Vector3d& position) {
  Pose T = Pose::Identity();
  T.linear().col(0) = Eigen::Vector3d::UnitX();
  T.linear().col(1) = -Eigen::Vector3d::UnitZ();
  T.linear().col(2) = Eigen::Vector3d::UnitY();
  T.translation() = position;
  return T;
}

struct Scene {
  std::vector<Correspondence> correspondences;
  std::vector<ViewRay> rays;
  std::vector<int> all;
  std::vector<Eigen::Vector3d> points;
  Pose T_query = lookNorth({0.5, -1, 2});
};

// A facade about the plane y = 10 with `relief`, which the model has as the plane y = 10 + `offset`, seen by three
// views.
Scene makeScene(unsigned seed, double relief, double offset, double noise, int count = 150) {
  Scene s;
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::normal_distribution<double> normal;
  s.T_query.linear() = s.T_query.linear() * air_ground_common::expSO3({0.05, -0.03, 0.02});
  const Eigen::Vector3d centres[] = {{-4, 0, 1.5}, {0, 0, 1.5}, {4, 1, 1.5}};
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d p(5 * unit(rng), 10 + relief * normal(rng), 3 + 3 * unit(rng));
    const auto pixel = camera().project(s.T_query.inverse() * p);
    if (!pixel || !camera().contains(*pixel)) continue;
    s.points.push_back(p);
    const Eigen::Vector2d seen = *pixel + noise * Eigen::Vector2d(normal(rng), normal(rng));
    for (const Eigen::Vector3d& centre : centres) {
      // The view's ray, blurred by its own pixel noise, cast onto the model's plane.
      Eigen::Vector3d d = p - centre;
      d += noise / kFocal * d.norm() * Eigen::Vector3d(normal(rng), 0, normal(rng));
      Correspondence c;
      c.pixel = seen;
      c.p_world = centre + d * ((10 + offset - centre.y()) / d.y());
      c.normal = -Eigen::Vector3d::UnitY();
      s.all.push_back(static_cast<int>(s.correspondences.size()));
      s.correspondences.push_back(c);
      s.rays.push_back({centre, 1 / kFocal, 0});
    }
  }
  return s;
}

TEST(PointFusion, FindsThePointsOfAFacadeThatTheModelMisplaces) {
  const Scene s = makeScene(1, 0.3, 0.1, 0);
  PointFusionSettings settings;
  settings.surface_stddev = 1;
  const auto fused = fusePoints(s.correspondences, s.rays, s.all, settings);
  ASSERT_EQ(fused.size(), s.points.size());
  for (std::size_t i = 0; i < fused.size(); ++i) {
    EXPECT_EQ(fused[i].sightings, 3);
    EXPECT_LT((fused[i].p_world - s.points[i]).norm(), 0.02);
    EXPECT_GT((s.correspondences[3 * i].p_world - s.points[i]).norm() + 1e-3, (fused[i].p_world - s.points[i]).norm());
  }
}

TEST(PointFusion, OneViewKeepsTheModelsPoint) {
  Scene s = makeScene(2, 0.3, 0, 0);
  std::vector<int> first;
  for (std::size_t i = 0; i < s.all.size(); i += 3) first.push_back(static_cast<int>(i));
  const auto fused = fusePoints(s.correspondences, s.rays, first, {});
  for (std::size_t i = 0; i < fused.size(); ++i) {
    EXPECT_LT((fused[i].p_world - s.correspondences[3 * i].p_world).norm(), 1e-6);
    // Along the ray it may lie about surface_stddev away, across it is known to a pixel.
    const Eigen::Vector3d ray = (s.correspondences[3 * i].p_world - s.rays[3 * i].centre).normalized();
    EXPECT_NEAR(std::sqrt(ray.dot(fused[i].covariance * ray)) * std::abs(ray.y()), PointFusionSettings().surface_stddev,
                0.05);
  }
}

TEST(PointFusion, PoseIsExactWithoutNoise) {
  const Scene s = makeScene(3, 0.3, 0.15, 0);
  PointFusionSettings settings;
  settings.surface_stddev = 3;
  const auto fused = fusePoints(s.correspondences, s.rays, s.all, settings);
  Pose start = s.T_query;
  start.translation() += Eigen::Vector3d(0.2, -0.3, 0.1);
  start.linear() = air_ground_common::expSO3({0.02, 0.01, -0.02}) * start.linear();
  const FusedRefinement r = refineOnFusedPoints(fused, camera(), {}, start, settings);
  ASSERT_TRUE(r.converged);
  EXPECT_LT((r.T_world_camera.translation() - s.T_query.translation()).norm(), 0.01);
  EXPECT_LT(air_ground_common::rotationAngle(r.T_world_camera.linear(), s.T_query.linear()), 0.001);
}

// Normalised error squared over many draws: its mean is the number of parameters when the covariance is right.
TEST(PointFusion, CovarianceFitsTheErrors) {
  PointFusionSettings settings;
  settings.surface_stddev = 0.3;
  double nees = 0, within_a_decimetre = 0;
  const int draws = 120;
  for (int i = 0; i < draws; ++i) {
    const Scene s = makeScene(100 + static_cast<unsigned>(i), 0.3, 0, 1.0, 80);
    const FusedRefinement r =
        refineOnFusedPoints(fusePoints(s.correspondences, s.rays, s.all, settings), camera(), {}, s.T_query, settings);
    ASSERT_TRUE(r.converged);
    Eigen::Matrix<double, 6, 1> error;
    error.head<3>() = s.T_query.translation() - r.T_world_camera.translation();
    error.tail<3>() = air_ground_common::logSO3(s.T_query.linear() * r.T_world_camera.linear().transpose());
    nees += error.dot(r.covariance.inverse() * error) / draws;
    within_a_decimetre += (error.head<3>().norm() < 0.1) / static_cast<double>(draws);
  }
  // Robust weights lower the mean of the information they use by a tenth or so; a wrong frame or sign gives hundreds.
  EXPECT_GT(nees, 4.0);
  EXPECT_LT(nees, 8.0);
  EXPECT_GT(within_a_decimetre, 0.8);
}

TEST(PointFusion, GravityHoldsTheTilt) {
  const Scene s = makeScene(5, 0.3, 0, 1.0, 12);
  PosePrior prior;
  prior.up_camera = s.T_query.linear().transpose() * Eigen::Vector3d::UnitZ();
  prior.up_stddev = 1e-4;
  Pose start = s.T_query;
  start.linear() = air_ground_common::expSO3({0.03, -0.02, 0.01}) * start.linear();
  const FusedRefinement r =
      refineOnFusedPoints(fusePoints(s.correspondences, s.rays, s.all, {}), camera(), prior, start, {});
  EXPECT_LT((r.T_world_camera.linear() * *prior.up_camera - Eigen::Vector3d::UnitZ()).norm(), 1e-3);
}

TEST(PointFusion, RefusesWhatCannotBe) {
  const Scene s = makeScene(6, 0, 0, 0, 5);
  EXPECT_THROW(fusePoints(s.correspondences, {}, s.all, {}), std::invalid_argument);
  EXPECT_THROW(fusePoints(s.correspondences, s.rays, {-1}, {}), std::invalid_argument);
  PointFusionSettings bad;
  bad.surface_stddev = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(fusePoints(s.correspondences, s.rays, s.all, bad), std::invalid_argument);
  EXPECT_FALSE(refineOnFusedPoints({}, camera(), {}, s.T_query, {}).converged);
}

}  // namespace
}  // namespace streetview_localizer
