// IMU samples addressed by the images' clock, in the axes that the IMU was told to have.
#pragma once

#include <optional>

#include "mav_vo/imu_preintegration.h"

namespace mav_vo {

class ImageClockImu {
 public:
  explicit ImageClockImu(double max_seconds) : buffer_(max_seconds) {}

  bool add(const ImuSample& sample) { return buffer_.add(sample); }
  void clear() { buffer_.clear(); }
  const ImuBuffer& buffer() const { return buffer_; }  ///< as they came

  /// R_given_imu: to the axes it was told to have from those it has.
  void setMounting(const Eigen::Matrix3d& R_given_imu) { R_given_imu_ = R_given_imu; }
  const Eigen::Matrix3d& mounting() const { return R_given_imu_; }

  /// t_imu = t_image + offset [s].
  void setOffset(double offset) { offset_ = offset; }
  double offset() const { return offset_; }
  double stamp(double image_stamp) const { return image_stamp + offset_; }

  /// R_t0_t1 of the axes it was told to have; empty where samples are missing. Biases are in these axes, too.
  std::optional<Eigen::Matrix3d> rotation(double t0, double t1, const Eigen::Vector3d& gyro_bias) const {
    const auto R = buffer_.integrateRotation(stamp(t0), stamp(t1), R_given_imu_.transpose() * gyro_bias);
    if (!R) return std::nullopt;
    return R_given_imu_ * *R * R_given_imu_.transpose();
  }

  std::optional<Preintegration> motion(double t0, double t1, const ImuNoise& noise, const ImuBias& bias,
                                       double max_gap) const {
    auto samples = samplesBetween(buffer_, stamp(t0), stamp(t1), max_gap);
    if (samples.size() < 2) return std::nullopt;
    for (ImuSample& sample : samples) sample = visual_frontend::turned(R_given_imu_, sample);
    Preintegration motion(noise, bias);
    motion.integrate(samples);
    return motion;
  }

 private:
  ImuBuffer buffer_;
  double offset_ = 0;
  Eigen::Matrix3d R_given_imu_ = Eigen::Matrix3d::Identity();
};

}  // namespace mav_vo
