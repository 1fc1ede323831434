// Stamps of what has come: a publisher that keeps messages sends them again when a connection is made again, after a
// restart of the master, say.
#pragma once

#include <ros/time.h>

#include <cstddef>
#include <set>

namespace air_ground_common::ros_utils {

class RecentStamps {
 public:
  bool has(const ros::Time& stamp) const { return stamps_.count(stamp) > 0; }
  void add(const ros::Time& stamp) {
    constexpr std::size_t kMost = 500;  // more than dense_fusion keeps
    stamps_.insert(stamp);
    if (stamps_.size() > kMost) stamps_.erase(stamps_.begin());
  }
  void clear() { stamps_.clear(); }

 private:
  std::set<ros::Time> stamps_;
};

}  // namespace air_ground_common::ros_utils
