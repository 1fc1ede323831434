// Rolling shutter: what each row of an image sees, carried to the camera's pose at the middle row.
#pragma once

#include "visual_frontend/types.h"

namespace visual_frontend {

/// Of a camera, in its own axes.
struct CameraVelocity {
  Eigen::Vector3d linear, angular;  ///< [m/s], [rad/s]
};

/// At T_map_camera, from where the camera was before and after; `dt`: between these two [s].
CameraVelocity velocityBetween(const Pose& T_map_before, const Pose& T_map_camera, const Pose& T_map_after, double dt);

/// Row r is exposed at stamp + (r / height - 0.5) * readout_time; during an image the camera's motion is uniform.
class RollingShutter {
 public:
  RollingShutter(const CameraModel& camera, double readout_time) : camera_(camera), readout_time_(readout_time) {}

  bool active() const { return readout_time_ != 0; }
  double readoutTime() const { return readout_time_; }  ///< [s]
  void setReadoutTime(double readout_time) { readout_time_ = readout_time; }
  void setCamera(const CameraModel& camera) { camera_ = camera; }

  /// Motion of the camera during the image, in its own frame: angular rate [rad/s], velocity [m/s].
  void setMotion(const Eigen::Vector3d& angular_rate, const Eigen::Vector3d& velocity) {
    angular_rate_ = angular_rate;
    velocity_ = velocity;
  }

  /// Point seen in a row, camera frame when that row was exposed, to the camera frame of the middle row [m].
  Eigen::Vector3d pointToMiddleRow(double row, const Eigen::Vector3d& p_camera) const;

  /// The converse: in the camera frame when that row was exposed [m].
  Eigen::Vector3d pointFromMiddleRow(double row, const Eigen::Vector3d& p_camera) const;

  /// Normalised coordinates as the camera at the middle row would see them. `inverse_depth` 0: far away or not known.
  Eigen::Vector2d toMiddleRow(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized,
                              double inverse_depth) const;

  /// The converse: pixel at which a point (camera frame of the middle row) appears, given where it would without.
  Eigen::Vector2d toItsRow(const Eigen::Vector2d& pixel, const Eigen::Vector3d& p_camera) const;

 private:
  double timeOf(double row) const { return ((row + 0.5) / camera_.height - 0.5) * readout_time_; }

  CameraModel camera_;
  double readout_time_;
  Eigen::Vector3d angular_rate_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();
};

}  // namespace visual_frontend
