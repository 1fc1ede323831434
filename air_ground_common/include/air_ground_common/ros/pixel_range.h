// Images of 16 bits that use only some of them.
#pragma once

#include <sensor_msgs/Image.h>

namespace air_ground_common::ros_utils {

/// Cameras of 10, 12 or 14 bits fill messages of 16 from below: read as they stand, such images are all but black.
/// Remembers of the images seen so far how many bits their camera has: it holds for all images from then on, and only
/// grows, so that brightness keeps its meaning from image to image. Not thread-safe.
class PixelRange {
 public:
  /// The image with its pixels moved up to the full range of 16 bits; itself where they are there already, or have 8
  /// bits.
  sensor_msgs::Image::ConstPtr full(const sensor_msgs::Image::ConstPtr& image);

 private:
  int bits_ = 0;  ///< of the brightest pixel so far, rounded up to a camera's; 0 = none seen
};

}  // namespace air_ground_common::ros_utils
