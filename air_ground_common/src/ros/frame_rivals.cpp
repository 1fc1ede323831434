#include "frame_rivals.h"

#include <ros/this_node.h>

#include <set>

namespace air_ground_common::ros_utils {

TransformBuffer::Listener countRivals(const EstimatorSettings& settings, NodeHealth& health) {
  if (!settings.publish_tf) return {};
  std::set<std::string> own{withoutSlash(settings.odom_frame)};
  if (!settings.odom_from_tf) own.insert(withoutSlash(settings.base_frame));
  return [own, &health](const geometry_msgs::TransformStamped& transform, const std::string& authority) {
    const std::string child = withoutSlash(transform.child_frame_id);
    if (own.count(child) == 0 || authority == ros::this_node::getName()) return;
    health.count(
        authority + " publishes '" + withoutSlash(transform.header.frame_id) + "' -> '" + child +
        "' on tf, and so does this node, with a parent of its own: the frame jumps between the two. What to do: "
        "set publish_tf to false here, or odom_from_tf to true where that node is the robot's odometry, or "
        "give each robot a base_frame and an odom_frame of its own");
  };
}

}  // namespace air_ground_common::ros_utils
