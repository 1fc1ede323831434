// Heading from a magnetometer and height from a barometer: the weak sensors beside the street-level fixes.
#pragma once

#include <Eigen/Core>
#include <optional>

namespace ekf_tracker {

/// Yaw [rad] of the body in an east-north-up frame (0 = x axis points east, pi/2 = north, counter-clockwise) from the
/// magnetic field in the body frame (x forward, y left, z up; any unit) and the body's levelling rotation (roll and
/// pitch, yaw 0). `declination`: of magnetic north from true north, east positive [rad]. Empty where the field is not
/// finite or its horizontal part is below `min_horizontal_share` of it (near a magnetic pole, or disturbed).
std::optional<double> yawFromMagneticField(const Eigen::Vector3d& field_body, const Eigen::Matrix3d& R_level_body,
                                           double declination, double min_horizontal_share = 0.1);

/// Height [m] above sea level in the International Standard Atmosphere (troposphere) for a pressure [Pa]. Only
/// differences over minutes mean something: weather moves it by metres an hour. Empty outside 20 to 120 kPa.
std::optional<double> heightFromPressure(double pressure);

}  // namespace ekf_tracker
