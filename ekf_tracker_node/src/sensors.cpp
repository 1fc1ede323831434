#include "ekf_tracker/sensors.h"

#include <cmath>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {

std::optional<double> yawFromMagneticField(const Eigen::Vector3d& field_body, const Eigen::Matrix3d& R_level_body,
                                           double declination, double min_horizontal_share) {
  if (!field_body.allFinite() || !R_level_body.allFinite() || !std::isfinite(declination)) return std::nullopt;
  const Eigen::Vector3d level = R_level_body * field_body;
  const double total = level.norm();
  if (!(total > 0) || level.head<2>().norm() < min_horizontal_share * total) return std::nullopt;
  // In the world the horizontal field points `declination` clockwise of north; in the levelled body it is seen at
  // atan2(y, x).
  return air_ground_common::wrapAngle(M_PI / 2 - declination - std::atan2(level.y(), level.x()));
}

std::optional<double> heightFromPressure(double pressure) {
  if (!(pressure >= 20e3 && pressure <= 120e3)) return std::nullopt;
  // ISA: 15 degC and 101325 Pa at sea level, 6.5 K/km.
  return 288.15 / 0.0065 * (1 - std::pow(pressure / 101325, 0.190263));
}

}  // namespace ekf_tracker
