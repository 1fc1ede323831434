#include "air_ground_sim/faults.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "air_ground_sim/random.h"

namespace air_ground_sim {
namespace {

void checkRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;
  std::ostringstream s;
  s << name << " = " << value << " is outside [" << low << ", " << high << "]";
  throw std::invalid_argument(s.str());
}

void checkBias(const char* name, const std::vector<double>& bias, double limit) {
  if (bias.size() > 1 && bias.size() != 3)
    throw std::invalid_argument(std::string(name) + " must be one number (its norm) or three");
  for (const double b : bias) checkRange(name, b, bias.size() == 1 ? 0 : -limit, limit);
}

const char* nameOf(StaticTransforms t) {
  switch (t) {
    case StaticTransforms::kSplit:
      return "split";
    case StaticTransforms::kPublishers:
      return "publishers";
    case StaticTransforms::kLatched:
      break;
  }
  return "latched";
}

std::string listOf(const std::vector<double>& numbers) {
  std::ostringstream s;
  s << '[';
  for (std::size_t i = 0; i < numbers.size(); ++i) s << (i ? ", " : "") << numbers[i];
  s << ']';
  return s.str();
}

}  // namespace

bool FaultsConfig::any() const {
  return time_offset != 0 || readout_time != 0 || vibration != 0 || !gyro_bias.empty() || !accel_bias.empty() ||
         start_in_motion || jpeg_quality != 0 || radial_error != 0 || focal_error != 0 || lost_images != 0 ||
         clock_offset != 0 || depth_delay != 0 || tf_static != StaticTransforms::kLatched;
}

void FaultsConfig::validate() const {
  checkRange("time_offset", time_offset, -0.5, 0.5);
  checkRange("readout_time", readout_time, 0, 0.1);
  checkRange("vibration", vibration, 0, 50);
  checkBias("gyro_bias", gyro_bias, 1);
  checkBias("accel_bias", accel_bias, 5);
  checkRange("jpeg_quality", jpeg_quality, 0, 100);
  checkRange("radial_error", radial_error, -1, 1);
  checkRange("focal_error", focal_error, -0.5, 0.5);
  checkRange("lost_images", lost_images, 0, 0.9);
  checkRange("clock_offset", clock_offset, -1000, 1000);
  checkRange("depth_delay", depth_delay, -0.04, 0.04);  // less than from an end of the way to an image
}

std::string FaultsConfig::describe() const {
  std::ostringstream s;
  s << "time_offset: " << time_offset << "\nreadout_time: " << readout_time << "\nvibration: " << vibration
    << "\ngyro_bias: " << listOf(gyro_bias) << "\naccel_bias: " << listOf(accel_bias)
    << "\nstart_in_motion: " << (start_in_motion ? "true" : "false") << "\njpeg_quality: " << jpeg_quality
    << "\nradial_error: " << radial_error << "\nfocal_error: " << focal_error << "\nlost_images: " << lost_images
    << "\nclock_offset: " << clock_offset << "\ndepth_delay: " << depth_delay << "\ntf_static: " << nameOf(tf_static)
    << '\n';
  return s.str();
}

FaultsConfig FaultsConfig::all() {
  FaultsConfig f;
  f.time_offset = 0.02;
  f.readout_time = 0.02;
  f.vibration = 1.0;
  f.gyro_bias = {0.08};
  f.accel_bias = {0.3};
  f.start_in_motion = true;
  f.jpeg_quality = 80;
  return f;
}

std::vector<bool> lostImages(double share, int count, std::uint64_t seed) {
  constexpr int kLongest = 5;
  constexpr double kMeanLength = (1 + kLongest) / 2.0;
  const double begins = share / (kMeanLength * (1 - share));  // at an image that is not lost
  Rng rng(seed);
  std::vector<bool> lost(count);
  for (int i = 0; i < count; ++i) {
    if (!rng.chance(begins)) continue;
    for (int left = 1 + rng.integer(kLongest); left > 0 && i < count; --left) lost[i++] = true;
  }
  return lost;
}

Eigen::Vector3d initialBias(double stddev, const Eigen::Vector3d& drawn, const std::vector<double>& asked) {
  if (asked.size() == 3) return {asked[0], asked[1], asked[2]};
  if (asked.size() == 1) return asked[0] * drawn.normalized();
  return stddev * drawn;
}

Vibration::Vibration(double rms, std::uint64_t seed) : amplitude_(rms * std::sqrt(2.0 / kTones)) {
  if (rms == 0) return;
  Rng rng(seed);
  for (int i = 0; i < 3 * kTones; ++i)
    tones_.push_back({2 * M_PI * rng.uniform(30, 120), rng.uniform(0, 2 * M_PI), rng.uniform(0, 2 * M_PI)});
}

Eigen::Vector3d Vibration::acceleration(double time) const {
  Eigen::Vector3d a = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < tones_.size(); ++i)
    a[static_cast<int>(i) / kTones] += amplitude_ * std::sin(tones_[i].frequency * time + tones_[i].phase);
  return a;
}

Eigen::Vector3d Vibration::angularVelocity(double time) const {
  constexpr double kArm = 0.1;  // [m]
  Eigen::Vector3d w = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < tones_.size(); ++i)
    w[static_cast<int>(i) / kTones] +=
        amplitude_ / (kArm * tones_[i].frequency) * std::sin(tones_[i].frequency * time + tones_[i].rocking_phase);
  return w;
}

}  // namespace air_ground_sim
