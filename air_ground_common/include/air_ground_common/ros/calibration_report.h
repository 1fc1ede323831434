// Tells users that an estimator goes by another calibration than the camera's driver says.
#pragma once

#include <string>

#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {

/// The radial distortion k1 that is in use: in /diagnostics, and on the console when the images have corrected it.
class CalibrationReport {
 public:
  /// `camera`: as users know it, e.g. "colour camera". `health` must outlive this.
  CalibrationReport(NodeHealth& health, const std::string& camera) : health_(health), camera_(camera) {}

  /// What camera_info says.
  void setGiven(double k1) { given_ = told_ = k1; }
  /// Called after each image.
  void update(double k1);

 private:
  NodeHealth& health_;
  const std::string camera_;
  double given_ = 0, told_ = 0;
};

}  // namespace air_ground_common::ros_utils
