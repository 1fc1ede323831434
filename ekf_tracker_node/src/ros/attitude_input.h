// Roll, pitch and magnetic heading of the MAV from the messages that tell them.
#pragma once

#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/MagneticField.h>

#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/transform_buffer.h"
#include "ekf_tracker/tilt_filter.h"
#include "ekf_tracker/tilt_source.h"
#include "sensor_bridge.h"

namespace ekf_tracker {

/// Subscribes to mav/odometry, mav/imu/data (or the accelerometer's own topic) and mav/imu/mag as the settings ask for
/// them. Callbacks of one thread.
class AttitudeInput {
 public:
  /// `on_pose`: after each pose of the odometry; `on_heading`: a measurement of the magnetometer. What is given must
  /// outlive this.
  AttitudeInput(ros::NodeHandle handle, const NodeSettings& settings, SensorBridge& bridge,
                air_ground_common::ros_utils::NodeHealth& health, std::function<void()> on_pose,
                std::function<void(const Measurement&)> on_heading);

  const TiltSource& tilts() const { return tilts_; }
  /// The odometry's turn, in order: carries along what fixes and accelerometer tell of the vertical.
  void turned(const air_ground::VoIncrement& msg);
  void onFix(const geometry_msgs::PoseWithCovarianceStamped& msg);
  /// From the odometry or, without, from the fixes and the accelerometer; empty where none says anything.
  std::optional<Tilt> tiltAt(double stamp, const std::optional<air_ground_common::Pose>& T_map_base) const;
  /// Hands on the magnetometer's readings whose tilt is known. A reading waits, like an increment, for the odometry of
  /// its time, whose tilt is better than the accelerometer's.
  void drainFields();
  void clear();

 private:
  void onVoPose(const nav_msgs::Odometry::ConstPtr& msg);
  void onAcceleration(const sensor_msgs::Imu::ConstPtr& msg);
  void onMagneticField(const sensor_msgs::MagneticField::ConstPtr& msg);
  void applyField(const sensor_msgs::MagneticField& msg);
  std::optional<Tilt> tiltBy(const std::optional<air_ground_common::Pose>& T_map_base, double stamp,
                             double tolerance) const;
  std::optional<Eigen::Matrix3d> rotationFrom(const std::string& message_frame);

  const NodeSettings& settings_;
  SensorBridge& bridge_;
  air_ground_common::ros_utils::NodeHealth& health_;
  const std::function<void()> on_pose_;
  const std::function<void(const Measurement&)> on_heading_;
  TiltSource tilts_;
  TiltFilter filter_;
  air_ground_common::ros_utils::TransformBuffer transforms_;
  ros::Subscriber vo_poses_, accelerometer_, magnetometer_;
  std::deque<std::pair<sensor_msgs::MagneticField::ConstPtr, double>> pending_fields_;  ///< with their arrival [s]
};

}  // namespace ekf_tracker
