#include "air_ground_common/ros/image_input.h"

namespace air_ground_common::ros_utils {
namespace {

std::string topicOf(const std::string& topic, bool compressed, bool depth) {
  if (!compressed) return topic;
  return topic + (depth ? "/compressedDepth" : "/compressed");
}

bool namesTransport(const std::string& topic) {
  const std::string last = topic.substr(topic.rfind('/') + 1);
  return last == "compressed" || last == "compressedDepth";
}

}  // namespace

ImageInput::ImageInput(ros::NodeHandle handle, const std::string& topic, const std::string& transport, bool depth,
                       int queue, NodeHealth& health, const std::string& argument, const Callback& callback) {
  const std::string resolved = handle.resolveName(topic);
  const bool named = namesTransport(resolved), compressed = named || transport == "compressed";
  topic_ = named ? resolved : topicOf(resolved, compressed, depth);
  if (named)
    health.expectInput(topic_);
  else
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
