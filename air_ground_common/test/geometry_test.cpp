#include "air_ground_common/geometry.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>

namespace air_ground_common {
namespace {

Eigen::Vector3d randomVector(std::mt19937* rng, double scale) {
  std::uniform_real_distribution<double> u(-scale, scale);
  return {u(*rng), u(*rng), u(*rng)};
}

TEST(Geometry, ExpAndLogAreInverse) {
  std::mt19937 rng(1);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d v = randomVector(&rng, 1.7);
    EXPECT_LT((logSO3(expSO3(v)) - v).norm(), 1e-9);
  }
  EXPECT_LT(logSO3(expSO3({1e-10, 0, 0})).norm(), 2e-10);
  EXPECT_NEAR(logSO3(expSO3({0, 0, M_PI})).norm(), M_PI, 1e-6);
}

TEST(Geometry, ExpTurnsCounterClockwise) {
  EXPECT_LT((expSO3({0, 0, M_PI / 2}) * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(), 1e-12);
}

TEST(Geometry, RightJacobianMatchesFiniteDifferences) {
  std::mt19937 rng(2);
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector3d v = randomVector(&rng, 1.0);
    const Eigen::Matrix3d J = rightJacobianSO3(v);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d d = 1e-6 * Eigen::Vector3d::Unit(k);
      const Eigen::Vector3d numeric = logSO3(expSO3(v).transpose() * expSO3(v + d)) / 1e-6;
      EXPECT_LT((numeric - J.col(k)).norm(), 1e-5);
    }
  }
}

TEST(Geometry, WrapAngleStaysInHalfOpenInterval) {
  EXPECT_DOUBLE_EQ(wrapAngle(M_PI), M_PI);
  EXPECT_DOUBLE_EQ(wrapAngle(-M_PI), M_PI);
  EXPECT_NEAR(wrapAngle(3 * M_PI + 0.1), -M_PI + 0.1, 1e-12);
}

TEST(Geometry, LevelingRotationPutsUpOnZ) {
  const Eigen::Vector3d up(0.3, -0.2, 5);
  EXPECT_LT((levelingRotation(up) * up.normalized() - Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  EXPECT_LT((levelingRotation(-Eigen::Vector3d::UnitZ()) * -Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitZ()).norm(),
            1e-9);
  EXPECT_THROW(levelingRotation(Eigen::Vector3d::Zero()), std::invalid_argument);
  EXPECT_THROW(levelingRotation({std::numeric_limits<double>::quiet_NaN(), 0, 1}), std::invalid_argument);
}

TEST(Geometry, YawPoseAndYawOfAgree) {
  for (double yaw = -3; yaw <= 3; yaw += 0.25) EXPECT_NEAR(yawOf(yawPose(yaw, {1, 2, 3}).linear()), yaw, 1e-12);
}

TEST(Geometry, InterpolationIsMidwayAndValidityIsChecked) {
  const Pose T = interpolate(Pose::Identity(), yawPose(1.0, {2, 0, 0}), 0.5);
  EXPECT_NEAR(yawOf(T.linear()), 0.5, 1e-12);
  EXPECT_NEAR(T.translation().x(), 1.0, 1e-12);
  EXPECT_TRUE(isValid(T));
  Pose mirrored = T;
  mirrored.linear().col(0) *= -1;
  EXPECT_FALSE(isValid(mirrored));
}

TEST(Geometry, OpticalFrameOfAForwardCamera) {
  const Eigen::Matrix3d R = opticalFromForwardBody();
  EXPECT_LT((R * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitZ()).norm(), 1e-12) << "forward is the optical axis";
  EXPECT_LT((R * Eigen::Vector3d::UnitY() + Eigen::Vector3d::UnitX()).norm(), 1e-12) << "left is -x in the image";
  EXPECT_NEAR(R.determinant(), 1.0, 1e-12);
}

}  // namespace
}  // namespace air_ground_common
