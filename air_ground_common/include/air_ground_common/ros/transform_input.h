// What comes on /tf and /tf_static, for as long as this lives.
#pragma once

#include <ros/callback_queue.h>
#include <ros/node_handle.h>
#include <ros/spinner.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/buffer.h>

#include <functional>
#include <string>

namespace air_ground_common::ros_utils {

/// tf2_ros::TransformListener, which a transform at the end of time ends with the process: tf2 adds the time that it
/// keeps transforms to each stamp, and that throws. Here such transforms are left out. On a thread of its own.
class TransformInput {
 public:
  /// Hears each transform that the buffer was given, and the name of the node that sent it.
  using Listener = std::function<void(const geometry_msgs::TransformStamped& transform, const std::string& authority)>;

  /// The buffer must outlive this, as must what the listener uses: it is called on the thread of this.
  explicit TransformInput(tf2_ros::Buffer& buffer, Listener listener = {});

 private:
  void onMessage(const tf2_msgs::TFMessage& message, const std::string& authority, bool fixed);

  tf2_ros::Buffer& buffer_;
  const Listener listener_;
  ros::Time last_;  ///< by the node's clock
  ros::CallbackQueue queue_;
  ros::NodeHandle handle_;
  ros::Subscriber moving_, fixed_;
  ros::AsyncSpinner spinner_{1, &queue_};
};

}  // namespace air_ground_common::ros_utils
