#include "air_ground_common/ros/image_input.h"

namespace air_ground_common::ros_utils {
namespace {

std::string topicOf(const std::string& topic, bool compressed, bool depth) {
  if (!compressed) return topic;
  return topic + (depth ? "/compressedDepth" : "/compressed");
}

}  // namespace

ImageInput::ImageInput(ros::NodeHandle handle, const std::string& topic, const std::string& transport, bool depth,
                       int queue, NodeHealth& health, const std::string& argument, const Callback& callback) {
  const bool compressed = transport == "compressed";
  const std::string resolved = handle.resolveName(topic);
  topic_ = topicOf(resolved, compressed, depth);
  health.expectInput(topic_, true, topicOf(resolved, !compressed, depth),
                     "set " + argument + " to " + (compressed ? "raw" : "compressed"));
  const auto onMessage = [&health, callback, name = topic_](const ImageMessage& message) {
    health.received(name, message.header().stamp);
    callback(message);
  };
  if (compressed)
    subscriber_ = handle.subscribe<sensor_msgs::CompressedImage>(
        topic_, queue, [onMessage](const sensor_msgs::CompressedImage::ConstPtr& msg) {
          onMessage({nullptr, msg});
        });
  else
    subscriber_ =
        handle.subscribe<sensor_msgs::Image>(topic_, queue, [onMessage](const sensor_msgs::Image::ConstPtr& msg) {
          onMessage({msg, nullptr});
        });
}

}  // namespace air_ground_common::ros_utils
