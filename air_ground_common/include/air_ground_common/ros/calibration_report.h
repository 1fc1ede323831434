// Tells users that an estimator goes by another calibration than the camera's driver, or tf, says.
#pragma once

#include <string>

#include "air_ground_common/geometry.h"
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

/// How the IMU is turned against the mounting that was given: in /diagnostics, and on the console when turns have shown
/// it for ten seconds, with the rotation that would be right.
class MountingReport {
 public:
  /// `base_frame`: whose mountings they are. `health` must outlive this.
  MountingReport(NodeHealth& health, const std::string& base_frame) : health_(health), base_frame_(base_frame) {}

  void setGiven(const Eigen::Matrix3d& R_base_imu) {
    R_base_imu_ = R_base_imu;
    told_.setIdentity();
  }
  /// Called after each image of this stamp [s]: turns what the IMU reads into the axes that were given.
  void update(double stamp, const Eigen::Matrix3d& R_given_imu);

 private:
  NodeHealth& health_;
  const std::string base_frame_;
  Eigen::Matrix3d R_base_imu_ = Eigen::Matrix3d::Identity(), told_ = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d steady_ = Eigen::Matrix3d::Identity();  ///< what it has been near since
  double steady_since_ = 0;                               ///< [s]
};

}  // namespace air_ground_common::ros_utils
