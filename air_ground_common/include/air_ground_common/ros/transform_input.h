// What comes on /tf and /tf_static, for as long as this lives.
#pragma once

#include <ros/callback_queue.h>
#include <ros/node_handle.h>
#include <ros/spinner.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/buffer.h>

namespace air_ground_common::ros_utils {

/// tf2_ros::TransformListener, which a transform at the end of time ends with the process: tf2 adds the time that it
/// keeps transforms to each stamp, and that throws. Here such transforms are left out. On a thread of its own.
class TransformInput {
 public:
  /// The buffer must outlive this.
  explicit TransformInput(tf2_ros::Buffer& buffer);

 private:
  void onMessage(const tf2_msgs::TFMessage& message, const std::string& authority, bool fixed);

  tf2_ros::Buffer& buffer_;
  ros::Time last_;  ///< by the node's clock
  ros::CallbackQueue queue_;
  ros::NodeHandle handle_;
  ros::Subscriber moving_, fixed_;
  ros::AsyncSpinner spinner_{1, &queue_};
};

}  // namespace air_ground_common::ros_utils
