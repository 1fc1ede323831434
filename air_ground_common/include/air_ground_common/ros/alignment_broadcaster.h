// The edge between two robots' maps on tf, which an alignment tells as long as it holds.
#pragma once

#include <ros/node_handle.h>
#include <tf2_ros/transform_broadcaster.h>

#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "air_ground_common/ros/tf_edge.h"

namespace air_ground_common::ros_utils {

/// Thread-safe.
class AlignmentBroadcaster {
 public:
  struct Edge {
    std::string parent, child;
    Pose T_parent_child;
  };

  /// Sends what `edge` gives, if anything, `rate` times a second by the ROS clock.
  AlignmentBroadcaster(double rate, std::function<std::optional<Edge>()> edge)
      : edge_(std::move(edge)),
        timer_(ros::NodeHandle().createTimer(ros::Duration(1 / rate), [this](const ros::TimerEvent&) { send(); })) {}

  /// At once, too.
  void send() {
    const std::lock_guard<std::mutex> lock(mutex_);
    const ros::Time now = ros::Time::now();
    // The clock stands still while a bag is paused: the same stamp is not sent again.
    if (now.isZero() || now == sent_) return;
    const auto edge = edge_();
    if (!edge) return;
    sent_ = now;
    broadcaster_.sendTransform(tfEdge(now, edge->parent, edge->child, edge->T_parent_child));
  }

 private:
  std::function<std::optional<Edge>()> edge_;
  std::mutex mutex_;
  ros::Time sent_;
  tf2_ros::TransformBroadcaster broadcaster_;
  ros::Timer timer_;
};

}  // namespace air_ground_common::ros_utils
