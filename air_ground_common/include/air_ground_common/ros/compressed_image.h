// Images that came compressed.
#pragma once

#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

namespace air_ground_common::ros_utils {

/// Pixels of a JPEG or PNG, as mono8, mono16, bgr8, bgra8; or of compressedDepth of image_transport (PNG behind a
/// header), as 16UC1 [mm] or 32FC1 [m]. Throws std::invalid_argument.
sensor_msgs::Image::Ptr decompressed(const sensor_msgs::CompressedImage& msg);

}  // namespace air_ground_common::ros_utils
