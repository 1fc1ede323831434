// tf, odometry and path of a robot that estimates its own motion (REP-105): map -> odom -> base_link.
#pragma once

#include <geometry_msgs/PoseStamped.h>
#include <nav_msgs/Path.h>
#include <ros/node_handle.h>
#include <tf2_ros/transform_broadcaster.h>

#include <memory>
#include <optional>
#include <string>

#include "air_ground_common/geometry.h"
#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {

/// A path for display that stays small however long the flight: a pose every `step` metres; when it holds `most`, every
/// second one is dropped and the step doubled.
class BoundedPath {
 public:
  /// `interval`: shortest time between two publications, as each sends the whole path [s].
  BoundedPath(const std::string& frame_id, double step, std::size_t most = 5000, double interval = 1.0);

  /// Takes the pose if it lies a step away from the last one kept. True when the path should be published: it has
  /// grown, and the interval has passed by the poses' stamps (or they ran back).
  bool add(const geometry_msgs::PoseStamped& pose);
  const nav_msgs::Path& message() const { return path_; }
  void clear();

 private:
  nav_msgs::Path path_;
  double first_step_, step_, interval_;
  std::size_t most_;
  bool grown_ = false;
  ros::Time published_;
};

class MapToOdom;

struct PosePublisherSettings {
  std::string map_frame, odom_frame, base_frame;
  std::string odometry_topic, path_topic;
  bool publish_tf = true;
  bool odom_from_tf = false;  ///< odom -> base is another node's: map -> odom alone is published, to fit it
  double path_step = 0.02;    ///< the path gains a pose after this distance [m], more when it is long: see BoundedPath
};

/// Motion of the base from the last published pose to this one as it was tracked, free of corrections.
struct Motion {
  Pose T_previous_current = Pose::Identity();
  std::optional<Matrix6d>
      covariance;  ///< of its translation and rotation, axes of the earlier base [m^2, m rad, rad^2]
};

/// Publishes nav_msgs/Odometry (pose in the map frame, twist in the base frame), a nav_msgs/Path and, if switched on,
/// the two tf edges. odom -> base never jumps but at reset(): what loop closure or bundle adjustment corrects, and
/// where a new map begins, goes into map -> odom. Call it from one thread at a time.
class PosePublisher {
 public:
  /// With `odom_from_tf`, poses for which tf has no odom -> base are counted in `health`, which must outlive this.
  PosePublisher(ros::NodeHandle handle, const PosePublisherSettings& settings, NodeHealth& health);
  ~PosePublisher();

  /// `T_map_base`: current best pose; `covariance`: of it in the map frame. The twist is the mean of the motion; where
  /// that is not known (the first pose, no covariance) its variances are 1e6. A stamp not later than the last one
  /// published is ignored (TF_REPEATED_DATA) and false is returned.
  bool publish(const ros::Time& stamp, const Pose& T_map_base, const Motion& motion, const Matrix6d& covariance);

  /// The next pose is of another map: the path ends, odom -> base stays where it was.
  void beginMap();
  /// Time has jumped, or all begins anew: odom -> base, too.
  void reset();

 private:
  PosePublisherSettings settings_;
  ros::Publisher odometry_, path_;
  tf2_ros::TransformBroadcaster broadcaster_;
  std::unique_ptr<MapToOdom> map_to_odom_;  ///< with odom_from_tf
  std::optional<Pose> T_odom_base_;
  bool map_begins_ = true;  ///< with the next pose, which no motion leads to
  ros::Time last_stamp_;
  BoundedPath bounded_path_;
};

}  // namespace air_ground_common::ros_utils
