// For tests of what a node says.
#pragma once

#include <ros/node_handle.h>
#include <rosgraph_msgs/Log.h>

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "air_ground_common/ros/node_testing.h"

namespace air_ground_common::ros_utils {

/// What this process says on the console, as it goes to /rosout.
class Console {
 public:
  Console() {
    subscriber_ = ros::NodeHandle().subscribe<rosgraph_msgs::Log>(
        "/rosout", 1000, [this](const rosgraph_msgs::Log::ConstPtr& m) { lines_.push_back(*m); });
    spinUntil([this] { return subscriber_.getNumPublishers() > 0; });
  }
  /// Lines with that in them, of at least this level.
  std::ptrdiff_t count(const std::string& part, int level = rosgraph_msgs::Log::DEBUG) const {
    return std::count_if(lines_.begin(), lines_.end(), [&](const rosgraph_msgs::Log& line) {
      return line.level >= level && line.msg.find(part) != std::string::npos;
    });
  }

 private:
  std::vector<rosgraph_msgs::Log> lines_;
  ros::Subscriber subscriber_;
};

}  // namespace air_ground_common::ros_utils
