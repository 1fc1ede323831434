#include "compass_input.h"

#include <cmath>

#include "air_ground_common/ros/conversions.h"

namespace heightmap_mcl {

namespace ros_utils = air_ground_common::ros_utils;

namespace {
constexpr double kAttitudeAge = 0.3;  // [s] of the odometry that levels a reading
}

CompassInput::CompassInput(ros::NodeHandle& handle, ros_utils::NodeHealth& health, double sigma)
    : health_(health), sigma_(sigma) {
  using Field = sensor_msgs::MagneticFieldConstPtr;
  using Odometry = nav_msgs::OdometryConstPtr;
  mav_.odometry = handle.subscribe<nav_msgs::Odometry>("mav/odometry", 100,
                                                       [this](const Odometry& msg) { onOdometry(mav_, *msg); });
  ground_.odometry = handle.subscribe<nav_msgs::Odometry>("ground/odometry", 100,
                                                          [this](const Odometry& msg) { onOdometry(ground_, *msg); });
  mav_.field = handle.subscribe<sensor_msgs::MagneticField>("mav/imu/mag", 100,
                                                            [this](const Field& msg) { onField(mav_, *msg); });
  ground_.field = handle.subscribe<sensor_msgs::MagneticField>("ground/imu/mag", 100,
                                                               [this](const Field& msg) { onField(ground_, *msg); });
}

void CompassInput::onOdometry(Robot& robot, const nav_msgs::Odometry& msg) {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    robot.R_map_base = Eigen::Quaterniond(ros_utils::fromMsg(msg.pose.pose).rotation());
    robot.stamp = msg.header.stamp;
    robot.base_frame = msg.child_frame_id;
  } catch (const std::invalid_argument& e) {
    health_.count("odometry of the " + robot.name + " not usable for the compass: " + e.what());
  }
}

void CompassInput::onField(Robot& robot, const sensor_msgs::MagneticField& msg) {
  Eigen::Quaterniond R_base_sensor = Eigen::Quaterniond::Identity();
  if (msg.header.frame_id != robot.base_frame) {
    const auto T_base_sensor = transforms_.lookup(robot.base_frame, msg.header.frame_id);
    if (!T_base_sensor) {
      health_.count("magnetic field of the " + robot.name + " without a transform from its frame to the robot's base");
      return;
    }
    R_base_sensor = T_base_sensor->linear();
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!robot.R_map_base || std::abs(msg.header.stamp.toSec() - robot.stamp.toSec()) > kAttitudeAge) {
    health_.count("magnetic field of the " + robot.name + " without odometry at its stamp");
    return;
  }
  const Eigen::Vector3d field(msg.magnetic_field.x, msg.magnetic_field.y, msg.magnetic_field.z);
  if (!robot.north.add(*robot.R_map_base * (R_base_sensor * field))) {
    health_.count("magnetic field of the " + robot.name + " not usable: not finite, or vertical");
  }
}

std::optional<Prior> CompassInput::prior() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return headingPrior(ground_.north, mav_.north, sigma_);
}

void CompassInput::forgetMav() {
  const std::lock_guard<std::mutex> lock(mutex_);
  mav_.north.clear();
  mav_.R_map_base.reset();
}

void CompassInput::forgetGround() {
  const std::lock_guard<std::mutex> lock(mutex_);
  ground_.north.clear();
  ground_.R_map_base.reset();
}

}  // namespace heightmap_mcl
