#include "air_ground_common/ros/transform_input.h"

#include <ros/console.h>
#include <ros/message_event.h>

#include <cmath>
#include <utility>

#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {
namespace {

/// tf2 looks for NaN, and takes infinity.
bool isFinite(const geometry_msgs::Transform& T) {
  for (const double number :
       {T.translation.x, T.translation.y, T.translation.z, T.rotation.x, T.rotation.y, T.rotation.z, T.rotation.w})
    if (!std::isfinite(number)) return false;
  return true;
}

}  // namespace

TransformInput::TransformInput(tf2_ros::Buffer& buffer, Listener listener)
    : buffer_(buffer), listener_(std::move(listener)) {
  using Event = ros::MessageEvent<tf2_msgs::TFMessage const>;
  buffer_.setUsingDedicatedThread(true);  // who waits for a transform may
  handle_.setCallbackQueue(&queue_);
  const auto listen = [this](const char* topic, bool fixed) {
    return handle_.subscribe<tf2_msgs::TFMessage>(
        topic, 100, boost::function<void(const Event&)>([this, fixed](const Event& event) {
          onMessage(*event.getConstMessage(), event.getPublisherName(), fixed);
        }));
  };
  moving_ = listen("/tf", false);
  fixed_ = listen("/tf_static", true);
  spinner_.start();
}

void TransformInput::onMessage(const tf2_msgs::TFMessage& message, const std::string& authority, bool fixed) {
  const ros::Time now = ros::Time::now();
  if (now < last_) {
    ROS_WARN("time jumped back (a looped bag?): what moved on tf is forgotten");
    buffer_.clear();
  }
  last_ = now;
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    if (transform.header.stamp.toSec() > kEndOfStamps) {
      ROS_WARN_STREAM_ONCE("tf: a transform to '"
                           << transform.child_frame_id << "', from " << authority
                           << ", has no time: such are left out. Let that node stamp them, or send them on /tf_static");
      continue;
    }
    try {
      if (!isFinite(transform.transform)) throw tf2::InvalidArgumentException("a number is not finite");
      buffer_.setTransform(transform, authority, fixed);
    } catch (const tf2::TransformException& e) {
      ROS_ERROR_STREAM_THROTTLE(10, "tf: a transform to '" << transform.child_frame_id << "', from " << authority
                                                           << ", is left out: " << e.what()
                                                           << ". That node is at fault");
      continue;
    }
    if (listener_) listener_(transform, authority);
  }
}

}  // namespace air_ground_common::ros_utils
