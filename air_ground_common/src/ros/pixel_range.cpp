#include "air_ground_common/ros/pixel_range.h"

#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <cmath>
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

/// A pixel's bytes, whichever comes first.
class Bytes {
 public:
  explicit Bytes(const sensor_msgs::Image& image) : high_(image.is_bigendian ? 0 : 1) {}
  unsigned read(const std::uint8_t* pixel) const { return static_cast<unsigned>(pixel[high_]) << 8 | pixel[1 - high_]; }
  void write(unsigned value, std::uint8_t* pixel) const {
    pixel[high_] = static_cast<std::uint8_t>(value >> 8);
    pixel[1 - high_] = static_cast<std::uint8_t>(value & 255);
  }

 private:
  std::size_t high_;
};

/// Calls `visit` with each value's bytes; what fills up the rows (step) holds none.
template <typename Data, typename Visit>
void forEachValue(const sensor_msgs::Image& image, Data& data, const Visit& visit) {
  const std::size_t channels = static_cast<std::size_t>(sensor_msgs::image_encodings::numChannels(image.encoding)),
                    row_bytes = std::min<std::size_t>(image.step, 2 * channels * image.width);
  for (std::size_t row = 0; (row + 1) * image.step <= data.size() && row < image.height; ++row)
    for (std::size_t i = 0; i + 1 < row_bytes; i += 2) visit(&data[row * image.step + i]);
}

}  // namespace

void PixelRange::count(const sensor_msgs::Image& image) {
  const Bytes bytes(image);
  histogram_.assign(65536, 0);
  counted_ = 0;
  forEachValue(image, image.data, [&](const std::uint8_t* value) {
    ++histogram_[bytes.read(value)];
    ++counted_;
  });
}

unsigned PixelRange::quantile(double share) const {
  const double below = share * static_cast<double>(counted_ - 1);
  std::uint64_t sum = 0;
  for (unsigned value = 0; value < histogram_.size(); ++value)
    if (sum += histogram_[value]; static_cast<double>(sum) > below) return value;
  return 65535;
}

bool PixelRange::updateBits() {
  constexpr double kHot = 1e-4;  // of the pixels may lie beyond the camera's bits, at least one
  const auto hot = std::max(std::uint64_t{1}, static_cast<std::uint64_t>(kHot * static_cast<double>(counted_)));
  std::uint64_t above = 0;
  unsigned brightest = 65535;
  while (brightest > 0 && (above += histogram_[brightest]) <= hot) --brightest;
  const int before = bits_;
  if (brightest > 0) bits_ = std::max(bits_, bitsFor(brightest));
  return bits_ > before;
}

void PixelRange::follow() {
  constexpr double kTail = 0.005, kMargin = 0.1;        // left out at each end; room beside what is left
  constexpr double kNarrow = 1 / 4.0, kWide = 1 / 3.0;  // of the range
  constexpr double kEven = 1 / 256.0;                   // less is noise
  constexpr double kStep = 0.03;                        // of the span, from one image to the next
  const double range = 1 << bits_;
  const Window used{static_cast<double>(quantile(kTail)), quantile(1 - kTail) + 1.0};
  if (used.span() < kEven * range) return;
  narrow_ = used.span() < (narrow_ ? kWide : kNarrow) * range;
  const double margin = kMargin * used.span();
  const Window wanted = narrow_ ? Window{used.low - margin, used.high + margin} : Window{0, range};
  const double in_window = std::min(window_.high, used.high) - std::max(window_.low, used.low);
  if (!begun_ || in_window < 0.5 * used.span()) {
    window_ = wanted;
  } else {
    const double span = window_.span() * std::clamp(wanted.span() / window_.span(), 1 - kStep, 1 + kStep);
    const double most = 0.5 * kStep * window_.span(), middle = 0.5 * (window_.low + window_.high);
    const double moved = middle + std::clamp(0.5 * (wanted.low + wanted.high) - middle, -most, most);
    window_ = {moved - 0.5 * span, moved + 0.5 * span};
  }
  begun_ = true;
}

sensor_msgs::Image::ConstPtr PixelRange::full(const sensor_msgs::Image::ConstPtr& image) {
  if (!hasSixteenBits(image->encoding) || image->data.size() < 2) return image;
  count(*image);
  if (counted_ == 0) return image;
  const bool more = updateBits();
  if (bits_ == 0) return image;  // black
  const double range = 1 << bits_;
  if (more) {
    window_ = {0, range};
    narrow_ = false;
  }
  if (!more || !begun_) follow();
  const bool all = std::abs(window_.low) < 1e-6 && std::abs(window_.span() - range) < 1e-6;
  if (all) window_ = {0, range};
  if (all && bits_ == 16) return image;
  auto moved = boost::make_shared<sensor_msgs::Image>(*image);
  const Bytes bytes(*image);
  const double gain = 65536 / window_.span();
  forEachValue(*image, moved->data, [&](std::uint8_t* value) {
    bytes.write(static_cast<unsigned>(std::clamp((bytes.read(value) - window_.low) * gain, 0.0, 65535.0)), value);
  });
  return moved;
}

}  // namespace air_ground_common::ros_utils
