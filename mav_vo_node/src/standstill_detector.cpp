#include "mav_vo/standstill_detector.h"

#include <cmath>

#include "air_ground_common/statistics.h"
#include "mav_vo/imu_preintegration.h"

namespace mav_vo {

namespace {

constexpr std::size_t kMinFeatures = 10;  // a camera that sees nothing knows nothing
constexpr int kMinSamples = 20;

using air_ground_common::median;

}  // namespace

void StandstillDetector::reset() {
  still_since_ = -1;
  reference_.clear();
}

bool StandstillDetector::imageStill(const std::vector<visual_frontend::Feature>& features) const {
  std::vector<double> step, drift;
  for (const auto& f : features) {
    if (f.age > 0) step.push_back((f.pixel - f.previous_pixel).norm());
    const auto before = reference_.find(f.id);
    if (before != reference_.end()) drift.push_back((f.pixel - before->second).norm());
  }
  if (step.size() < kMinFeatures || median(step) >= settings_.pixels) return false;
  // A slow turn hides below the threshold from image to image, not over the rest.
  return still_since_ < 0 || (drift.size() >= kMinFeatures && median(drift) < settings_.drift_pixels);
}

std::optional<Standstill> StandstillDetector::add(double stamp, const std::vector<visual_frontend::Feature>& features,
                                                  const visual_frontend::ImuBuffer& imu, double imu_stamp) {
  if (!imageStill(features)) {
    reset();
    return std::nullopt;
  }
  if (still_since_ < 0) {
    still_since_ = stamp;
    for (const auto& f : features) reference_[f.id] = f.pixel;
  }
  if (stamp - still_since_ < settings_.duration) return std::nullopt;
  const auto mean = imu.mean(imu_stamp - settings_.duration, imu_stamp);
  if (mean.count < kMinSamples || mean.angular_velocity_std > settings_.gyro_scatter ||
      mean.specific_force_std > settings_.accel_scatter || mean.angular_velocity.norm() > settings_.max_gyro_bias ||
      std::abs(mean.specific_force.norm() - kGravity) > settings_.max_accel_bias)
    return std::nullopt;
  return Standstill{mean.angular_velocity, mean.specific_force.normalized()};
}

}  // namespace mav_vo
