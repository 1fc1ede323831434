// What tf says, for as long as this lives.
#pragma once

#include <geometry_msgs/TransformStamped.h>
#include <ros/callback_queue.h>
#include <ros/node_handle.h>
#include <ros/spinner.h>
#include <tf2_msgs/TFMessage.h>

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"

namespace tf2 {
class BufferCore;
}

namespace air_ground_common::ros_utils {

/// tf2_ros::Buffer and TransformListener, which a transform at the end of time ends with the process: tf2 adds the time
/// that it keeps transforms to each stamp, and that throws. Here such transforms, and those with a number that is not
/// finite, are left out. Hears on a thread of its own; static transforms are kept whoever publishes them, latched or
/// not. Keeps 10 s of what moves. Thread-safe. Leading slashes of frames do not matter.
class TransformBuffer {
 public:
  /// Hears each transform that was taken, and the name of the node that sent it.
  using Listener = std::function<void(const geometry_msgs::TransformStamped& transform, const std::string& authority)>;

  /// What the listener uses must outlive this: it is called on the thread of this.
  explicit TransformBuffer(Listener listener = {});
  ~TransformBuffer();

  /// T_target_source at `stamp`; without, the newest. Never waits, never throws. Empty where tf does not know it, or
  /// where edges that are hardly rotations make none together; then `why`, when given, says so.
  std::optional<Pose> lookup(const std::string& target, const std::string& source, const ros::Time& stamp = ros::Time(),
                             std::string* why = nullptr) const;

  /// Of the newest transform between them: zero for one that is fixed, empty where tf knows none.
  std::optional<ros::Time> newest(const std::string& target, const std::string& source) const;

  /// All frames that were named.
  std::vector<std::string> frames() const;

  /// Forgets what moves; what is on /tf_static stays.
  void clear();

 private:
  void onMessage(const tf2_msgs::TFMessage& message, const std::string& authority, bool fixed);

  const std::unique_ptr<tf2::BufferCore> core_;
  const Listener listener_;
  ros::Time last_;  ///< by the node's clock
  ros::CallbackQueue queue_;
  ros::NodeHandle handle_;
  ros::Subscriber moving_, fixed_;
  ros::AsyncSpinner spinner_{1, &queue_};
};

}  // namespace air_ground_common::ros_utils
