// IMU samples addressed by the images' clock.
#pragma once

#include <optional>

#include "mav_vo/imu_preintegration.h"

namespace mav_vo {

class ImageClockImu {
 public:
  explicit ImageClockImu(double max_seconds) : buffer_(max_seconds) {}

  bool add(const ImuSample& sample) { return buffer_.add(sample); }
  void clear() { buffer_.clear(); }
  const ImuBuffer& buffer() const { return buffer_; }

  /// t_imu = t_image + offset [s].
  void setOffset(double offset) { offset_ = offset; }
  double offset() const { return offset_; }
  double stamp(double image_stamp) const { return image_stamp + offset_; }

  /// R_t0_t1 of the IMU; empty where samples are missing.
  std::optional<Eigen::Matrix3d> rotation(double t0, double t1, const Eigen::Vector3d& gyro_bias) const {
    return buffer_.integrateRotation(stamp(t0), stamp(t1), gyro_bias);
  }

  std::optional<Preintegration> motion(double t0, double t1, const ImuNoise& noise, const ImuBias& bias) const {
    const auto samples = samplesBetween(buffer_, stamp(t0), stamp(t1));
    if (samples.size() < 2) return std::nullopt;
    Preintegration motion(noise, bias);
    motion.integrate(samples);
    return motion;
  }

 private:
  ImuBuffer buffer_;
  double offset_ = 0;
};

}  // namespace mav_vo
