#include "ekf_tracker/sensors.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {
namespace {

TEST(Sensors, MagneticYawUnderTiltAndDeclination) {
  const double declination = 3 * M_PI / 180;
  // Zurich: about 21 uT horizontal, 43 uT down.
  const Eigen::Vector3d field_world(21 * std::sin(declination), 21 * std::cos(declination), -43);
  double worst_untilted = 0;
  for (double yaw = -3; yaw <= 3; yaw += 0.5) {
    const Eigen::Matrix3d tilt =
        (Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.15, Eigen::Vector3d::UnitX()))
            .toRotationMatrix();
    const Eigen::Matrix3d R_world_body = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix() * tilt;
    const auto measured = yawFromMagneticField(R_world_body.transpose() * field_world, tilt, declination);
    ASSERT_TRUE(measured);
    EXPECT_NEAR(air_ground_common::wrapAngle(*measured - yaw), 0, 1e-12);
    const double untilted =
        *yawFromMagneticField(R_world_body.transpose() * field_world, Eigen::Matrix3d::Identity(), declination);
    worst_untilted = std::max(worst_untilted, std::abs(air_ground_common::wrapAngle(untilted - yaw)));
  }
  // Without the tilt the vertical field, twice the horizontal one, spoils it.
  EXPECT_GT(worst_untilted, 0.3);
  // Facing north, the field comes from ahead.
  EXPECT_NEAR(*yawFromMagneticField({20, 0, -40}, Eigen::Matrix3d::Identity(), 0), M_PI / 2, 1e-12);
  // East: north is to the left.
  EXPECT_NEAR(*yawFromMagneticField({0, 20, -40}, Eigen::Matrix3d::Identity(), 0), 0, 1e-12);
  EXPECT_FALSE(yawFromMagneticField({0, 0.5, -40}, Eigen::Matrix3d::Identity(), 0));
  EXPECT_FALSE(yawFromMagneticField({NAN, 1, 1}, Eigen::Matrix3d::Identity(), 0));
  EXPECT_FALSE(yawFromMagneticField({0, 0, 0}, Eigen::Matrix3d::Identity(), 0));
}

TEST(Sensors, PressureOfTheStandardAtmosphere) {
  EXPECT_NEAR(*heightFromPressure(101325), 0, 1e-9);
  EXPECT_NEAR(*heightFromPressure(89874.6), 1000, 0.2);
  EXPECT_NEAR(*heightFromPressure(54019.9), 5000, 1);
  EXPECT_FALSE(heightFromPressure(957.9));  // hectopascal
  EXPECT_FALSE(heightFromPressure(NAN));
}

}  // namespace
}  // namespace ekf_tracker
