#include "mav_vo/rolling_shutter.h"

#include "air_ground_common/geometry.h"

namespace mav_vo {

Eigen::Vector2d RollingShutter::toMiddleRow(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized,
                                            double inverse_depth) const {
  if (!active()) return normalized;
  const double t = rowTime(pixel.y());
  const Eigen::Vector3d p =
      air_ground_common::expSO3(angular_rate_ * t) * normalized.homogeneous() + inverse_depth * t * velocity_;
  return p.z() > 0.1 ? Eigen::Vector2d(p.hnormalized()) : normalized;
}

Eigen::Vector2d RollingShutter::toItsRow(const Eigen::Vector2d& pixel, const Eigen::Vector3d& p_camera) const {
  if (!active()) return pixel;
  Eigen::Vector2d at = pixel;
  // The row depends on the motion during the time that the row tells: twice is enough.
  for (int i = 0; i < 2; ++i) {
    const double t = rowTime(at.y());
    const auto moved = camera_.project(air_ground_common::expSO3(-angular_rate_ * t) * (p_camera - t * velocity_));
    if (!moved) return pixel;
    at = *moved;
  }
  return at;
}

}  // namespace mav_vo
