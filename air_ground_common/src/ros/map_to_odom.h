// map -> odom for a robot whose own odometry publishes odom -> base_link (REP-105).
#pragma once

#include <tf2_ros/transform_broadcaster.h>

#include <deque>
#include <mutex>
#include <optional>
#include <string>

#include "air_ground_common/geometry.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/transform_buffer.h"

namespace air_ground_common::ros_utils {

/// Publishes map -> odom at the stamp of each pose, as soon as tf knows odom -> base there. Never waits for it.
/// Thread-safe.
class MapToOdom {
 public:
  /// Poses for which tf has no odom -> base within a second of data are counted in `health`, with what tf says.
  MapToOdom(const std::string& map_frame, const std::string& odom_frame, const std::string& base_frame,
            NodeHealth& health);

  /// Stamps go up.
  void add(const ros::Time& stamp, const Pose& T_map_base);
  /// Time has jumped: what waits and what moved on tf is forgotten.
  void reset();

 private:
  struct Waiting {
    ros::Time stamp;
    Pose T_map_base;
  };
  void publishKnown();

  const std::string map_frame_, odom_frame_, base_frame_;
  NodeHealth& health_;
  tf2_ros::TransformBroadcaster broadcaster_;
  std::mutex mutex_;
  std::deque<Waiting> waiting_;
  TransformBuffer transforms_;  ///< last: its thread uses the others
};

}  // namespace air_ground_common::ros_utils
