#include "visual_frontend/rolling_shutter.h"

#include <algorithm>

namespace visual_frontend {

namespace {

/// exp(v) * p to the second order: of the few degrees that a camera turns during an image, to a thousandth of a pixel.
Eigen::Vector3d rotate(const Eigen::Vector3d& v, const Eigen::Vector3d& p) {
  const Eigen::Vector3d turned = v.cross(p);
  return p + turned + 0.5 * v.cross(turned);
}

}  // namespace

CameraVelocity velocityBetween(const Pose& T_map_before, const Pose& T_map_camera, const Pose& T_map_after, double dt) {
  const Eigen::Matrix3d R_camera_map = T_map_camera.linear().transpose();
  const Eigen::Matrix3d turn = T_map_after.linear() * T_map_before.linear().transpose();
  return {R_camera_map * (T_map_after.translation() - T_map_before.translation()) / dt,
          R_camera_map * air_ground_common::logSO3(turn) / dt};
}

Eigen::Vector3d RollingShutter::pointToMiddleRow(double row, const Eigen::Vector3d& p_camera) const {
  if (!active()) return p_camera;
  const double t = timeOf(row);
  return rotate(angular_rate_ * t, p_camera) + t * velocity_;
}

Eigen::Vector3d RollingShutter::pointFromMiddleRow(double row, const Eigen::Vector3d& p_camera) const {
  if (!active()) return p_camera;
  const double t = timeOf(row);
  return rotate(-angular_rate_ * t, p_camera - t * velocity_);
}

Eigen::Vector2d RollingShutter::toMiddleRow(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized,
                                            double inverse_depth) const {
  if (!active()) return normalized;
  // The point at depth 1 with the velocity scaled alike: the same image, and good for points far away.
  const double t = timeOf(pixel.y());
  const Eigen::Vector3d p =
      rotate(angular_rate_ * t, normalized.homogeneous()) + t * std::max(0.0, inverse_depth) * velocity_;
  return p.z() > 0.1 ? Eigen::Vector2d(p.hnormalized()) : normalized;
}

Eigen::Vector2d RollingShutter::toItsRow(const Eigen::Vector2d& pixel, const Eigen::Vector3d& p_camera) const {
  if (!active()) return pixel;
  Eigen::Vector2d result = pixel;
  for (int i = 0; i < 3; ++i) {  // the motion decides the row, and the row how much of the motion
    const auto moved = camera_.project(pointFromMiddleRow(result.y(), p_camera));
    if (!moved) return pixel;
    result = *moved;
  }
  return result;
}

}  // namespace visual_frontend
