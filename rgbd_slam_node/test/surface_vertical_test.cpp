#include "rgbd_slam/surface_vertical.h"

#include <gtest/gtest.h>

#include <random>

#include "air_ground_common/geometry.h"

namespace rgbd_slam {
namespace {

constexpr double kMaxTilt = 0.8;

/// Patches of a surface with noisy normals.
void add(const Eigen::Vector3d& normal, double area, std::vector<SurfacePatch>* patches) {
  static std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.02);
  const int count = 200;
  for (int i = 0; i < count; ++i)
    patches->push_back(
        {(normal + Eigen::Vector3d(noise(random), noise(random), noise(random))).normalized(), area / count});
}

double angleTo(const std::optional<Eigen::Vector3d>& up, const Eigen::Vector3d& truth) {
  return up ? std::acos(std::min(1.0, up->dot(truth))) : INFINITY;
}

/// Map in which the room leans: floor, two walls, a table and a chair's back.
std::vector<SurfacePatch> room(const Eigen::Matrix3d& R, double floor) {
  std::vector<SurfacePatch> patches;
  add(R * Eigen::Vector3d(0, 0, 1), floor, &patches);
  add(R * Eigen::Vector3d(-1, 0, 0), 4, &patches);
  add(R * Eigen::Vector3d(0, 1, 0), 3, &patches);
  add(R * Eigen::Vector3d(0.5, 0, 0.87), 0.4, &patches);
  return patches;
}

TEST(SurfaceVertical, FindsTheFloorOfARoomThatLeans) {
  for (const Eigen::Vector3d& lean :
       {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(0.45, 0, 0), Eigen::Vector3d(-0.3, 0.5, 0.2)}) {
    const Eigen::Matrix3d R = air_ground_common::expSO3(lean);
    EXPECT_LT(angleTo(verticalOfSurfaces(room(R, 2), kMaxTilt), R.col(2)), 0.01);
    // A ceiling alone is seen from below.
    std::vector<SurfacePatch> ceiling;
    add(-R.col(2), 3, &ceiling);
    EXPECT_LT(angleTo(verticalOfSurfaces(ceiling, kMaxTilt), R.col(2)), 0.01);
  }
}

TEST(SurfaceVertical, WallsAndScrapsTellNothing) {
  EXPECT_FALSE(verticalOfSurfaces({}, kMaxTilt));
  std::vector<SurfacePatch> walls;
  add({-1, 0, 0}, 4, &walls);
  add({0, 1, 0.1}, 3, &walls);
  EXPECT_FALSE(verticalOfSurfaces(walls, kMaxTilt));
  add({0, 0, 1}, 0.5, &walls);
  EXPECT_FALSE(verticalOfSurfaces(walls, kMaxTilt)) << "7 % of what is seen";
}

TEST(SurfaceVertical, ARampBeforeALevelRobotIsNoFloor) {
  const Eigen::Vector3d ramp(0.3, 0, 0.95);
  std::vector<SurfacePatch> patches;
  add(ramp, 3, &patches);
  EXPECT_LT(angleTo(verticalOfSurfaces(patches, kMaxTilt), ramp.normalized()), 0.01);
  add({0, 0, 1}, 2, &patches);
  EXPECT_LT(angleTo(verticalOfSurfaces(patches, kMaxTilt), {0, 0, 1}), 0.01);
}

TEST(SurfaceVertical, OfTwoSlopesNoneIsUp) {
  std::vector<SurfacePatch> roof;
  add({0.5, 0, 0.87}, 3, &roof);
  add({-0.5, 0, 0.87}, 2.5, &roof);
  EXPECT_FALSE(verticalOfSurfaces(roof, kMaxTilt));
}

}  // namespace
}  // namespace rgbd_slam
