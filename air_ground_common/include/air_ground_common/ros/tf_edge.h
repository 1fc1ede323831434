// One edge of the tf tree as a message.
#pragma once

#include <geometry_msgs/TransformStamped.h>

#include <string>

#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {

inline geometry_msgs::TransformStamped tfEdge(const ros::Time& stamp, const std::string& parent,
                                              const std::string& child, const Pose& T_parent_child) {
  geometry_msgs::TransformStamped msg;
  msg.header.stamp = stamp;
  msg.header.frame_id = parent;
  msg.child_frame_id = child;
  msg.transform = toTransformMsg(T_parent_child);
  return msg;
}

}  // namespace air_ground_common::ros_utils
