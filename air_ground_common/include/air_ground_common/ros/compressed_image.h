// Images that came compressed.
#pragma once

#include <air_ground/PosedImage.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

#include <opencv2/core/mat.hpp>

namespace air_ground_common::ros_utils {

/// Pixels of a JPEG or PNG, as mono8, mono16, bayer_*, bgr8, bgra8; or of compressedDepth of image_transport (PNG
/// behind a header), as 16UC1 [mm] or 32FC1 [m]. Throws std::invalid_argument.
sensor_msgs::Image::Ptr decompressed(const sensor_msgs::CompressedImage& msg);

/// JPEG of an 8 bit image, grey or BGR. quality: 1..100. Throws std::invalid_argument for other pixels.
sensor_msgs::CompressedImage compressed(const cv::Mat& image, int quality, const std_msgs::Header& header);

/// Grey image, 8 bit, that owns its pixels, whichever way they came. Throws std::invalid_argument.
cv::Mat greyFromMsg(const air_ground::PosedImage& msg);

}  // namespace air_ground_common::ros_utils
