// Publishes the map's keyframes: where they stand, and of those that subscribers do not know yet what they show.
#pragma once

#include <ros/node_handle.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <set>
#include <string>

#include "visual_frontend/map.h"

namespace rgbd_slam {

/// All calls from one thread at a time.
class KeyframePublisher {
 public:
  KeyframePublisher(ros::NodeHandle handle, const std::string& topic, const std::string& frame);

  /// A subscriber has come that lacks what earlier keyframes show, and there may be no new one for long. At most once a
  /// second, whoever comes and goes.
  bool awaited() const;
  /// Without subscribers nothing is made.
  void resendAll() { known_.clear(); }  ///< features of earlier keyframes, too, with the next publish()
  void publish(std::uint32_t map_id, const ros::Time& stamp, const visual_frontend::Map& map);

 private:
  const std::string frame_;
  std::atomic<bool> subscriber_came_{false};
  std::chrono::steady_clock::time_point served_;
  std::uint32_t map_id_ = 0;
  std::set<visual_frontend::KeyframeId> known_;  // to all subscribers
  ros::Publisher publisher_;
};

}  // namespace rgbd_slam
