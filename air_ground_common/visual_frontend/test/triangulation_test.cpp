#include "visual_frontend/triangulation.h"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "synthetic.h"

namespace visual_frontend {
namespace {

using synthetic::Random;

std::vector<ViewRay> views(Random& random, const Eigen::Vector3d& p_map, const Pose& first, int count, double baseline,
                           double sigma) {
  std::vector<ViewRay> result;
  for (int i = 0; i < count; ++i) {
    ViewRay v;
    v.T_map_camera = first;
    if (i > 0) {
      v.T_map_camera.translation() +=
          first.linear() * Eigen::Vector3d(baseline * i, 0.3 * baseline * random.uniform(-1, 1), 0);
      v.T_map_camera.linear() = v.T_map_camera.linear() * air_ground_common::expSO3(random.vector(0.05));
    }
    const Eigen::Vector3d p = v.T_map_camera.inverse() * p_map;
    v.normalized = p.head<2>() / p.z() + Eigen::Vector2d(random.gauss(sigma), random.gauss(sigma));
    v.sigma = std::max(sigma, 1e-5);
    result.push_back(v);
  }
  return result;
}

TEST(Triangulation, ExactWithoutNoise) {
  Random random(1);
  for (int i = 0; i < 200; ++i) {
    const Pose T = synthetic::randomPose(random);
    const Eigen::Vector3d p = synthetic::visiblePoint(random, T);
    const auto r = triangulate(views(random, p, T, 3, 0.2, 0), {});
    ASSERT_TRUE(r.ok()) << toString(r.status);
    EXPECT_LT((r.p_map - p).norm(), 1e-6);
  }
}

TEST(Triangulation, CovarianceIsConsistentWithAndWithoutDepth) {
  Random random(2);
  for (const bool depth : {false, true}) {
    double nees = 0;
    constexpr int kTrials = 500;
    for (int i = 0; i < kTrials; ++i) {
      const Pose T = synthetic::randomPose(random);
      const Eigen::Vector3d p = synthetic::visiblePoint(random, T);
      auto v = views(random, p, T, 4, 0.15, 0.6 / 525);
      if (depth) {
        for (ViewRay& ray : v) {
          const double z = (ray.T_map_camera.inverse() * p).z();
          ray.depth_sigma = 0.003 * z * z;
          ray.depth = z + random.gauss(ray.depth_sigma);
        }
      }
      TriangulationSettings settings;
      settings.max_residual = 10;
      const auto r = triangulate(v, settings);
      ASSERT_TRUE(r.ok());
      nees += (r.p_map - p).dot(r.covariance.inverse() * (r.p_map - p));
    }
    EXPECT_NEAR(nees / kTrials, 3.0, 0.45) << "depth " << depth;
  }
}

TEST(Triangulation, PureRotationNeedsDepth) {
  Random random(3);
  const Pose T = synthetic::randomPose(random);
  const Eigen::Vector3d p = synthetic::visiblePoint(random, T);
  auto v = views(random, p, T, 3, 0.0, 0);
  EXPECT_EQ(triangulate(v, {}).status, TriangulationStatus::kLowParallax);
  const double z = (T.inverse() * p).z();
  v[0].depth = z;
  v[0].depth_sigma = 0.01;
  const auto r = triangulate(v, {});
  ASSERT_TRUE(r.ok());
  EXPECT_LT((r.p_map - p).norm(), 1e-6);
  EXPECT_NEAR(std::sqrt(r.covariance.trace()), 0.01, 0.005);
  // One view with depth is enough, one without is not.
  EXPECT_TRUE(triangulate({v[0]}, {}).ok());
  EXPECT_EQ(triangulate({v[1]}, {}).status, TriangulationStatus::kTooFewViews);
}

TEST(Triangulation, ReportsWhatIsWrong) {
  Random random(4);
  const Pose T = synthetic::randomPose(random);
  const Eigen::Vector3d p = synthetic::visiblePoint(random, T);
  auto v = views(random, p, T, 3, 0.2, 1e-3);
  v[2].normalized.y() += 0.1;
  EXPECT_EQ(triangulate(v, {}).status, TriangulationStatus::kLargeResidual);
  // Rays that diverge meet behind the cameras.
  std::vector<ViewRay> diverging(2);
  diverging[0].normalized = {-0.2, 0};
  diverging[1].T_map_camera.translation().x() = 0.5;
  diverging[1].normalized = {0.2, 0};
  EXPECT_EQ(triangulate(diverging, {}).status, TriangulationStatus::kBehindCamera);
  TriangulationSettings near;
  near.max_depth = 0.5;
  EXPECT_EQ(triangulate(views(random, p, T, 3, 0.2, 0), near).status, TriangulationStatus::kDepthRange);
}

}  // namespace
}  // namespace visual_frontend
