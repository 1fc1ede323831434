#include "air_ground_common/ros/calibration_report.h"

#include <ros/console.h>

#include <Eigen/Geometry>
#include <cmath>
#include <utility>

#include "air_ground_common/units.h"

namespace air_ground_common::ros_utils {

void CalibrationReport::update(double k1) {
  constexpr double kWorthALine = 0.001;  // half a pixel or so in the corners of an image
  health_.value("k1", k1);
  if (std::abs(k1 - told_) < kWorthALine) return;
  const double before = std::exchange(told_, k1);
  if (std::abs(k1 - given_) < kWorthALine) return;  // an estimator that was reset begins with what was given
  ROS_WARN(
      "The images show that the calibration of the %s is off: k1 is %.4f, not %.4f, and is used so. Calibrate it; "
      "radial_stddev: 0 keeps what camera_info says",
      camera_.c_str(), k1, before);
}

void MountingReport::update(double stamp, const Eigen::Matrix3d& R_given_imu) {
  constexpr double kWorthALine = 1;  // [degrees]
  // Estimates wander until the MAV has turned about all axes: a degree for some seconds, with a right mounting.
  constexpr double kWander = 0.5, kSteady = 10;  // [degrees], [s]
  const double turned = rotationAngle(Eigen::Matrix3d::Identity(), R_given_imu) / kDegree;
  health_.value("IMU turned against its mounting [degrees]", turned);
  if (rotationAngle(steady_, R_given_imu) > kWander * kDegree || stamp < steady_since_) {
    steady_ = R_given_imu;
    steady_since_ = stamp;
  }
  if (stamp - steady_since_ < kSteady || rotationAngle(told_, R_given_imu) < kWorthALine * kDegree) return;
  told_ = R_given_imu;
  if (turned < kWorthALine) return;  // an estimator that was reset begins with what was given
  const Eigen::Quaterniond q(R_base_imu_ * R_given_imu);
  ROS_WARN(
      "Turns of the camera show that camera and IMU are turned against each other by %.1f degrees more than their "
      "mountings say, and are used so. If the camera's is right, the IMU's rotation in %s is qx qy qz qw = %.4f %.4f "
      "%.4f %.4f: correct its static transform (URDF) or base_imu; imu_rotation_stddev: 0 keeps the mountings as they "
      "are",
      turned, base_frame_.c_str(), q.x(), q.y(), q.z(), q.w());
}

}  // namespace air_ground_common::ros_utils
