// Images as a camera's driver sends them, or compressed.
#pragma once

#include <ros/node_handle.h>
#include <functional>
#include <string>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {

/// One image message in either form.
struct ImageMessage {
  sensor_msgs::Image::ConstPtr raw;
  sensor_msgs::CompressedImage::ConstPtr compressed;

  const std_msgs::Header& header() const { return raw ? raw->header : compressed->header; }
  std::size_t bytes() const { return raw ? raw->data.size() : compressed->data.size(); }
  /// Throws std::invalid_argument when it cannot be decompressed.
  sensor_msgs::Image::ConstPtr pixels() const { return raw ? raw : decompressed(*compressed); }
};

/// Subscribes to a topic of images: `transport` "raw": sensor_msgs/Image on it; "compressed":
/// sensor_msgs/CompressedImage on <topic>/compressed, or <topic>/compressedDepth for depth images. A topic that ends in
/// /compressed or /compressedDepth itself is taken as that, whatever `transport` says.
class ImageInput {
 public:
  using Callback = std::function<void(const ImageMessage&)>;

  /// `argument` names what a user sets to have the other form, e.g. "argument mav_image_transport". The topic becomes
  /// an expected input of `health`, which hears of every message before the callback.
  ImageInput(ros::NodeHandle handle, const std::string& topic, const std::string& transport, bool depth, int queue,
             NodeHealth& health, const std::string& argument, const Callback& callback);

  /// Resolved.
  const std::string& topic() const { return topic_; }

 private:
  std::string topic_;
  ros::Subscriber subscriber_;
};

}  // namespace air_ground_common::ros_utils
