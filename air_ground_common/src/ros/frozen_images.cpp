#include "air_ground_common/ros/frozen_images.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

namespace air_ground_common::ros_utils {
namespace {

/// Bytes on a lattice over the image.
std::vector<std::uint8_t> some(const sensor_msgs::Image& image) {
  constexpr std::size_t kSide = 64;
  std::vector<std::uint8_t> pixels;
  if (image.height == 0 || image.step == 0 || image.data.size() < std::size_t{image.step} * image.height) return pixels;
  const std::size_t rows = std::min<std::size_t>(kSide, image.height),
                    columns = std::min<std::size_t>(kSide, image.step);
  pixels.reserve(rows * columns);
  for (std::size_t r = 0; r < rows; ++r)
    for (std::size_t c = 0; c < columns; ++c)
      pixels.push_back(image.data[r * image.height / rows * image.step + c * image.step / columns]);
  return pixels;
}

/// A covered lens, or light beyond the sensor, looks alike in all images.
bool blank(const std::vector<std::uint8_t>& pixels) {
  const auto [least, most] = std::minmax_element(pixels.begin(), pixels.end());
  return pixels.empty() || *least == *most;
}

}  // namespace

bool FrozenImages::repeats(const sensor_msgs::Image& image, const std::deque<ImuCombiner::Sample>& imu) {
  constexpr double kComesToRest = 0.5;  // [grey levels]: of a shift by a tenth of a pixel or so
  std::vector<std::uint8_t> pixels = some(image);
  if (pixels != pixels_ || blank(pixels)) {
    begin(image.header.stamp.toSec(), std::move(pixels));
    return false;
  }
  listen(imu);
  return difference_ > kComesToRest || imuMoves();
}

void FrozenImages::begin(double stamp, std::vector<std::uint8_t> pixels) {
  double sum = 0;
  const bool comparable = !pixels.empty() && pixels.size() == pixels_.size();
  for (std::size_t i = 0; comparable && i < pixels.size(); ++i) sum += std::abs(int{pixels[i]} - int{pixels_[i]});
  difference_ = comparable ? sum / static_cast<double>(pixels.size()) : 0;
  pixels_ = std::move(pixels);
  since_ = stamp;
  sum_ = {};
  in_sum_ = means_ = 0;
}

void FrozenImages::listen(const std::deque<ImuCombiner::Sample>& imu) {
  constexpr int kSamples = 5;  // so that their noise counts less
  for (const ImuCombiner::Sample& sample : imu) {
    sum_.angular_velocity += sample.angular_velocity;
    sum_.specific_force += sample.specific_force;
    if (++in_sum_ < kSamples) continue;
    Eigen::Array<double, 6, 1> mean;
    mean << sum_.angular_velocity / kSamples, sum_.specific_force / kSamples;
    least_ = means_ == 0 ? mean : least_.min(mean);
    most_ = means_ == 0 ? mean : most_.max(mean);
    ++means_;
    sum_ = {};
    in_sum_ = 0;
  }
}

bool FrozenImages::imuMoves() const {
  constexpr double kTurns = 0.1, kAccelerates = 0.6;  // [rad/s], [m/s^2]: between the extremes, noise and all
  if (means_ == 0) return false;
  const auto range = (most_ - least_).eval();
  return range.head<3>().maxCoeff() > kTurns || range.tail<3>().maxCoeff() > kAccelerates;
}

}  // namespace air_ground_common::ros_utils
