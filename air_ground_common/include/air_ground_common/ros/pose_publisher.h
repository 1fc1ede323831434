// tf, odometry and path of a robot that estimates its own motion (REP-105): map -> odom -> base_link.
#pragma once

#include <nav_msgs/Path.h>
#include <ros/node_handle.h>
#include <tf2_ros/transform_broadcaster.h>

#include <optional>
#include <string>

#include "air_ground_common/geometry.h"

namespace air_ground_common::ros_utils {

struct PosePublisherSettings {
  std::string map_frame, odom_frame, base_frame;
  std::string odometry_topic, path_topic;
  bool publish_tf = true;
  double path_step = 0.02;  ///< the path gains a pose after this distance [m]
};

/// Publishes nav_msgs/Odometry (pose in the map frame), a nav_msgs/Path and, if switched on, the two tf edges.
/// The odom frame never jumps: what loop closure or bundle adjustment corrects goes into map -> odom.
class PosePublisher {
 public:
  PosePublisher(ros::NodeHandle handle, const PosePublisherSettings& settings);

  /// `T_map_base`: current best pose. `T_previous_current`: motion of the base since the last call as it was tracked,
  /// free of corrections; pass identity for the first. `covariance`: of the pose in the map frame.
  /// A stamp not later than the last one published is ignored (TF_REPEATED_DATA) and false is returned.
  bool publish(const ros::Time& stamp, const Pose& T_map_base, const Pose& T_previous_current, const Matrix6d& covariance);

  /// Starts afresh: path and odometry are cleared.
  void reset();

 private:
  PosePublisherSettings settings_;
  ros::Publisher odometry_, path_;
  tf2_ros::TransformBroadcaster broadcaster_;
  std::optional<Pose> T_odom_base_;
  ros::Time last_stamp_;
  nav_msgs::Path path_msg_;
};

/// Looks up a fixed transform T_target_source, e.g. base_link <- camera. Waits up to `timeout` wall seconds in total;
/// empty, with the reason in `why`, when it does not come.
std::optional<Pose> lookupStatic(const std::string& target, const std::string& source, double timeout, std::string* why);

}  // namespace air_ground_common::ros_utils
