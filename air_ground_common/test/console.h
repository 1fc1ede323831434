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
        "/rosout", 1000, [this](const rosgraph_msgs::Log::ConstPtr& m) { lines_.push_back(m->msg); });
    spinUntil([this] { return subscriber_.getNumPublishers() > 0; });
  }
  std::ptrdiff_t count(const std::string& part) const {
    return std::count_if(lines_.begin(), lines_.end(),
                         [&](const std::string& line) { return line.find(part) != std::string::npos; });
  }

 private:
  std::vector<std::string> lines_;
  ros::Subscriber subscriber_;
};

}  // namespace air_ground_common::ros_utils
