#include "air_ground_common/ros/pixel_range.h"

#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <string>

namespace air_ground_common::ros_utils {
namespace {

bool hasSixteenBits(const std::string& encoding) {
  namespace enc = sensor_msgs::image_encodings;
  return encoding == enc::MONO16 || encoding == enc::TYPE_16UC1 || encoding == enc::RGB16 || encoding == enc::BGR16 ||
         encoding == enc::BAYER_RGGB16 || encoding == enc::BAYER_BGGR16 || encoding == enc::BAYER_GBRG16 ||
         encoding == enc::BAYER_GRBG16;
}

/// Of a camera whose brightest pixel is `value`.
int bitsFor(unsigned value) {
  for (const int bits : {10, 12, 14})
    if (value >> bits == 0) return bits;
  return 16;
}

}  // namespace

sensor_msgs::Image::ConstPtr PixelRange::full(const sensor_msgs::Image::ConstPtr& image) {
  if (bits_ == 16 || !hasSixteenBits(image->encoding)) return image;
  const std::size_t high = image->is_bigendian ? 0 : 1;  // byte of a pixel
  const auto value = [high](const std::uint8_t* pixel) {
    return static_cast<unsigned>(pixel[high]) << 8 | pixel[1 - high];
  };
  unsigned brightest = 0;
  const std::vector<std::uint8_t>& data = image->data;
  for (std::size_t i = 1; i < data.size(); i += 2) brightest = std::max(brightest, value(&data[i - 1]));
  if (brightest == 0) return image;
  bits_ = std::max(bits_, bitsFor(brightest));
  if (bits_ == 16) return image;
  auto moved = boost::make_shared<sensor_msgs::Image>(*image);
  for (std::size_t i = 1; i < moved->data.size(); i += 2) {
    std::uint8_t* pixel = &moved->data[i - 1];
    const unsigned shifted = value(pixel) << (16 - bits_);
    pixel[high] = static_cast<std::uint8_t>(shifted >> 8);
    pixel[1 - high] = static_cast<std::uint8_t>(shifted & 255);
  }
  return moved;
}

}  // namespace air_ground_common::ros_utils
