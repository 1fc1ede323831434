// Images of 16 bits that use only some of them.
#pragma once

#include <sensor_msgs/Image.h>

#include <cstdint>
#include <vector>

namespace air_ground_common::ros_utils {

/// Cameras of 10, 12 or 14 bits fill messages of 16 from below: read as they stand, such images are all but black.
/// Remembers of the images seen so far how many bits their camera has: it holds for all images from then on, and only
/// grows, so that brightness keeps its meaning from image to image; single hot pixels have no say in it.
/// What uses less than a quarter of that range (thermal cameras: 7400 to 7900 of 16384) is stretched to all of it, by a
/// window that follows the images slowly: contrast changes by 3 % from one to the next, unless the window would miss
/// half of what there is. Not thread-safe.
class PixelRange {
 public:
  /// The image with its pixels spread over the full range of 16 bits; itself where they are so already, or have 8 bits.
  sensor_msgs::Image::ConstPtr full(const sensor_msgs::Image::ConstPtr& image);

 private:
  /// Counts, from the one that becomes 0 to the one that becomes 65536.
  struct Window {
    double low = 0, high = 0;
    double span() const { return high - low; }
  };

  void count(const sensor_msgs::Image& image);
  /// The count that all but the smallest `share` of the last image's pixels reach.
  unsigned quantile(double share) const;
  /// True where the camera turns out to have more bits than thought.
  bool updateBits();
  /// Moves the window towards what the last image uses.
  void follow();

  int bits_ = 0;         ///< of the brightest pixels so far, rounded up to a camera's; 0 = none seen
  Window window_;        ///< in use
  bool begun_ = false;   ///< an image has shown more than one even grey
  bool narrow_ = false;  ///< the images use little of the range
  std::vector<std::uint32_t> histogram_;
  std::uint64_t counted_ = 0;
};

}  // namespace air_ground_common::ros_utils
