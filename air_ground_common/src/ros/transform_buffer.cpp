#include "air_ground_common/ros/transform_buffer.h"

#include <ros/console.h>
#include <ros/message_event.h>
#include <tf2/buffer_core.h>
#include <tf2/exceptions.h>

#include <cmath>
#include <stdexcept>
#include <utility>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/sensor_input.h"

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

TransformBuffer::TransformBuffer(Listener listener)
    : core_(std::make_unique<tf2::BufferCore>()), listener_(std::move(listener)) {
  using Event = ros::MessageEvent<tf2_msgs::TFMessage const>;
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

TransformBuffer::~TransformBuffer() { spinner_.stop(); }

std::optional<Pose> TransformBuffer::lookup(const std::string& target, const std::string& source,
                                            const ros::Time& stamp, std::string* why) const {
  const std::string to = withoutSlash(target), from = withoutSlash(source);
  if (!core_->canTransform(to, from, stamp, why)) return std::nullopt;
  try {
    return fromMsg(core_->lookupTransform(to, from, stamp).transform);
  } catch (const tf2::TransformException& e) {  // gone since it was asked for
    if (why) *why = e.what();
  } catch (const std::invalid_argument& e) {
    if (why) *why = e.what();
  }
  return std::nullopt;
}

std::optional<ros::Time> TransformBuffer::newest(const std::string& target, const std::string& source) const {
  try {
    return core_->lookupTransform(withoutSlash(target), withoutSlash(source), ros::Time()).header.stamp;
  } catch (const tf2::TransformException&) {
    return std::nullopt;
  }
}

std::vector<std::string> TransformBuffer::frames() const {
  std::vector<std::string> names;
  core_->_getFrameStrings(names);
  return names;
}

void TransformBuffer::clear() { core_->clear(); }

void TransformBuffer::onMessage(const tf2_msgs::TFMessage& message, const std::string& authority, bool fixed) {
  const ros::Time now = ros::Time::now();
  if (now < last_) {
    ROS_WARN("time jumped back (a looped bag?): what moved on tf is forgotten");
    core_->clear();
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
      core_->setTransform(transform, authority, fixed);
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
