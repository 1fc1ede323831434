// Surfaces of depth images upon each other, against true poses of a camera in a room of planes.
#include "rgbd_slam/depth_surface.h"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "../src/keyframe_surfaces.h"
#include "air_ground_common/linear_algebra.h"
#include "synthetic.h"

namespace rgbd_slam {
namespace {

namespace synthetic = visual_frontend::synthetic;
using air_ground_common::CameraModel;
using air_ground_common::Pose;
using air_ground_common::Vector6d;
using synthetic::Plane;
using visual_frontend::RollingShutter;

/// A floor, and two walls that meet in a corner.
std::vector<Plane> corner() {
  return {{Eigen::Vector3d::UnitZ(), 0}, {Eigen::Vector3d(0.8, 0.6, 0), 2.2}, {Eigen::Vector3d(-0.6, 0.8, 0), 1.7}};
}

/// Nearest plane in front of each pixel, with a Kinect's noise (`noise` times DepthModel's).
cv::Mat depthOf(const CameraModel& camera, const Pose& T_world_camera, const std::vector<Plane>& planes, double noise,
                unsigned seed) {
  synthetic::Random random(seed);
  const DepthModel model;
  cv::Mat depth(camera.height, camera.width, CV_32F);
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      const double nearest = synthetic::depthOfPlanes(planes, camera, T_world_camera, {u, v});
      depth.at<float>(v, u) = static_cast<float>(nearest + random.gauss(noise * model.sigma(nearest)));
    }
  }
  return depth;
}

/// Looks into the corner from 1 m above the floor, 20 degrees down.
Pose standing(double x, double y, double turn) {
  Pose T = Pose::Identity();
  T.linear() =
      (Eigen::AngleAxisd(1.3 + turn, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.35, Eigen::Vector3d::UnitY()))
          .toRotationMatrix() *
      air_ground_common::opticalFromForwardBody().transpose();
  T.translation() = Eigen::Vector3d(x, y, 1);
  return T;
}

Pose disturbed(const Pose& T, double metres, double radians) {
  Pose d = Pose::Identity();
  d.translation() = metres * Eigen::Vector3d(0.6, -0.64, 0.48);
  d.linear() = air_ground_common::expSO3(radians * Eigen::Vector3d(-0.48, 0.6, 0.64));
  return T * d;
}

DepthSurface surfaceOf(const CameraModel& camera, const cv::Mat& depth) {
  return DepthSurface(camera, depth, {}, RollingShutter(camera, 0));
}

TEST(DepthSurface, CellsLieOnThePlanesAndLookAtTheCamera) {
  const CameraModel camera = synthetic::camera(true);
  const Pose T = standing(0, 0, 0);
  const DepthSurface surface = surfaceOf(camera, depthOf(camera, T, corner(), 0, 1));
  EXPECT_GT(surface.known(), surface.cells().size() / 2);
  int away = 0;
  for (const DepthSurface::Cell& cell : surface.cells()) {
    if (!(cell.sigma > 0)) continue;
    double nearest = 1, along = 0;
    for (const auto& [n, d] : corner()) {
      const double distance = std::abs(n.dot(T * cell.position.cast<double>()) - d);
      if (distance > nearest) continue;
      nearest = distance;
      along = std::abs(n.dot(T.linear() * cell.normal.cast<double>()));
    }
    EXPECT_LT(cell.normal.dot(cell.position), 0);
    away += nearest > 1e-3 || along < 0.999;  // where two planes meet
  }
  EXPECT_LT(away, 0.08 * static_cast<double>(surface.known()));
}

TEST(AlignSurfaces, FindsWhereACameraStandsInACorner) {
  const CameraModel camera = synthetic::camera(true);
  double nees = 0;
  constexpr int kTrials = 6;
  for (unsigned seed = 0; seed < kTrials; ++seed) {
    const Pose T_a = standing(0, 0, 0), T_b = standing(0.15, -0.1, 0.15);
    const DepthSurface a = surfaceOf(camera, depthOf(camera, T_a, corner(), 1, 2 * seed + 1)),
                       b = surfaceOf(camera, depthOf(camera, T_b, corner(), 1, 2 * seed + 2));
    const Pose T_a_b = T_a.inverse() * T_b;
    const SurfaceAlignment aligned = alignSurfaces(camera, a, b, disturbed(T_a_b, 0.05, 0.04));
    ASSERT_TRUE(aligned.success) << aligned.reason;
    EXPECT_GT(aligned.overlap, 0.6);
    const Pose error = T_a_b.inverse() * aligned.T_a_b;
    EXPECT_LT(error.translation().norm(), 4e-3);
    EXPECT_LT(air_ground_common::rotationAngle(error.linear(), Eigen::Matrix3d::Identity()), 2e-3);
    Vector6d e;
    e << error.translation(), air_ground_common::logSO3(error.linear());
    nees += e.dot(aligned.information * e) / kTrials;
  }
  EXPECT_LT(nees, 6 * 1.5);  // of six numbers
}

TEST(AlignSurfaces, APlaneLeavesThreeDirectionsOpenAndWhereTheyWere) {
  const CameraModel camera = synthetic::camera(true);
  const std::vector<Plane> floor{{Eigen::Vector3d::UnitZ(), 0}};
  const Pose T_a = standing(0, 0, 0), T_b = disturbed(T_a, 0.03, 0.02);
  const Pose start = disturbed(T_a.inverse() * T_b, 0.03, 0.02);
  const SurfaceAlignment aligned = alignSurfaces(camera, surfaceOf(camera, depthOf(camera, T_a, floor, 1, 1)),
                                                 surfaceOf(camera, depthOf(camera, T_b, floor, 1, 2)), start);
  ASSERT_TRUE(aligned.success) << aligned.reason;
  const auto eigen = air_ground_common::symmetricEigen(aligned.information);
  EXPECT_NEAR(eigen.values[2], 0, 1e-6 * eigen.values[3]);
  EXPECT_GT(eigen.values[3], 1e4);
  // Height and lean are known; the rest stays.
  const Pose T_world_b = T_a * aligned.T_a_b;
  EXPECT_NEAR(T_world_b.translation().z(), T_b.translation().z(), 5e-3);
  EXPECT_LT(((T_world_b.linear().transpose() - T_b.linear().transpose()) * Eigen::Vector3d::UnitZ()).norm(), 3e-3);
  EXPECT_LT((T_world_b.translation() - (T_a * start).translation()).head<2>().norm(), 0.02);
}

TEST(AlignSurfaces, OtherPlacesAreNotTheSame) {
  const CameraModel camera = synthetic::camera(true);
  const Pose T = standing(0, 0, 0);
  const DepthSurface a = surfaceOf(camera, depthOf(camera, T, corner(), 1, 1));
  const DepthSurface b = surfaceOf(camera, depthOf(camera, T, {{Eigen::Vector3d(0.7, 0.7, 0.14), 0.8}}, 1, 2));
  EXPECT_FALSE(alignSurfaces(camera, a, b, Pose::Identity()).success);
  const cv::Mat nothing(camera.height, camera.width, CV_32F, cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  const SurfaceAlignment blind = alignSurfaces(camera, a, surfaceOf(camera, nothing), Pose::Identity());
  EXPECT_FALSE(blind.success);
  EXPECT_NE(blind.reason.find("0 of 0 cells"), std::string::npos) << blind.reason;
  EXPECT_THROW(surfaceOf(camera, cv::Mat(10, 10, CV_32F, cv::Scalar(1))), std::invalid_argument);
  EXPECT_THROW(surfaceOf(camera, cv::Mat(camera.height, camera.width, CV_16U, cv::Scalar(1))), std::invalid_argument);
}

TEST(KeyframeSurfaces, TwoKeyframesHaveOneLinkHoweverManyWereReplaced) {
  const CameraModel camera = synthetic::camera(true);
  KeyframeSurfaces surfaces(camera, SlamSettings());
  visual_frontend::Map map;
  const auto add = [&](const Pose& T) {
    visual_frontend::Keyframe keyframe;
    keyframe.T_map_camera = T;
    const KeyframeId id = map.addKeyframe(keyframe);
    surfaces.add(id, surfaceOf(camera, depthOf(camera, T, corner(), 0.3, static_cast<unsigned>(id) + 1)));
    return id;
  };
  const KeyframeId first = add(standing(0, 0, 0)), second = add(standing(0.15, -0.1, 0.1));
  KeyframeId there = add(standing(0.1, 0.1, -0.1));
  surfaces.link(second, {first}, map);
  surfaces.link(there, {first, second}, map);
  surfaces.tie(there, first, 1e-4 * Matrix6d::Identity(), map);
  ASSERT_EQ(surfaces.links().size(), 4u);
  // Another keyframe takes the place of the third, and another one that of this.
  for (int i = 1; i < 4; ++i) {
    const KeyframeId again = add(standing(0.1 + 0.01 * i, 0.1, -0.1));
    surfaces.link(again, {there, first, second}, map);
    surfaces.tie(again, first, 1e-4 * Matrix6d::Identity(), map);
    surfaces.replace(there, again, map);
    map.removeKeyframe(there);
    there = again;
    EXPECT_EQ(surfaces.links().size(), 4u) << i;
    EXPECT_EQ(surfaces.linkedTo(there).size(), 3u) << "to both by the surfaces, and once by all that gave its pose";
    for (const auto& link : surfaces.links()) {
      const Pose T_a_b = map.keyframe(link.a).T_map_camera.inverse() * map.keyframe(link.b).T_map_camera;
      EXPECT_LT((link.T_a_b.translation() - T_a_b.translation()).norm(), 3e-3);
    }
  }
  // What only the replaced one was linked to goes on.
  const KeyframeId fresh = add(standing(0.12, 0.1, -0.1));
  surfaces.replace(there, fresh, map);
  EXPECT_EQ(surfaces.links().size(), 4u);
}

}  // namespace
}  // namespace rgbd_slam
