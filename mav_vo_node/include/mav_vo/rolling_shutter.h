// Rolling shutter: what a row sees, carried to the pose that the camera has at the middle row, to first order in the
// time between them.
#pragma once

#include <Eigen/Core>

#include "air_ground_common/camera_model.h"

namespace mav_vo {

/// Row r of an image is exposed at stamp + (r / height - 0.5) * readout_time.
class RollingShutter {
 public:
  RollingShutter(const air_ground_common::CameraModel& camera, double readout_time)
      : camera_(camera), readout_time_(readout_time) {}

  bool active() const { return readout_time_ != 0; }

  /// Motion of the camera during the image, in its own frame: angular rate [rad/s], velocity [unit of the depths / s].
  void setMotion(const Eigen::Vector3d& angular_rate, const Eigen::Vector3d& velocity) {
    angular_rate_ = angular_rate;
    velocity_ = velocity;
  }

  /// Normalised coordinates of the same point as the camera's pose at the middle row sees it. `inverse_depth` 0: far
  /// away, or not known.
  Eigen::Vector2d toMiddleRow(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized,
                              double inverse_depth) const;

  /// The converse: pixel at which a point (in the camera's frame at the middle row) appears, given its pixel without
  /// rolling shutter.
  Eigen::Vector2d toItsRow(const Eigen::Vector2d& pixel, const Eigen::Vector3d& p_camera) const;

 private:
  double rowTime(double row) const { return ((row + 0.5) / camera_.height - 0.5) * readout_time_; }

  air_ground_common::CameraModel camera_;
  double readout_time_;
  Eigen::Vector3d angular_rate_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();
};

}  // namespace mav_vo
