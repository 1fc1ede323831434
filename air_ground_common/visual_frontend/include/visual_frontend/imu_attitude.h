// Rotation between frames from the gyroscope, and which way is up.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "visual_frontend/types.h"

namespace visual_frontend {

struct ImuSample {
  double stamp = 0;                                            ///< [s]
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  ///< IMU frame [rad/s]
  Eigen::Vector3d specific_force = Eigen::Vector3d::Zero();    ///< IMU frame [m/s^2]; +9.81 along up at rest
};

/// Samples in order of time, of limited length.
class ImuBuffer {
 public:
  explicit ImuBuffer(double max_seconds = 10.0) : max_seconds_(max_seconds) {}

  /// False (sample dropped) when it is not finite, beyond what an IMU can read (kMaxAngularVelocity,
  /// kMaxSpecificForce), not newer than the last, or a
  /// leap of less than 0.03 s.
  bool add(const ImuSample& sample);
  void clear() { samples_.clear(); }
  const std::deque<ImuSample>& samples() const { return samples_; }
  bool empty() const { return samples_.empty(); }

  /// True when samples reach from t0 to t1 with no gap longer than max_gap [s].
  bool covers(double t0, double t1, double max_gap = 0.05) const;

  /// Rotation R_t0_t1 (maps vectors of the IMU frame at t1 to that at t0) from the gyroscope less its bias; midpoint
  /// rule between samples, linear interpolation at the ends. Empty when the interval is not covered. t1 >= t0.
  std::optional<Eigen::Matrix3d> integrateRotation(double t0, double t1, const Eigen::Vector3d& gyro_bias) const;

  struct Mean {
    int count = 0;
    Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
    Eigen::Vector3d specific_force = Eigen::Vector3d::Zero();
    double angular_velocity_std = 0;  ///< root of the summed variances [rad/s]
    double specific_force_std = 0;    ///< [m/s^2]
  };
  /// Mean and scatter of the samples in [t0, t1].
  Mean mean(double t0, double t1) const;

 private:
  double max_seconds_;
  std::deque<ImuSample> samples_;
};

/// Notices an IMU whose samples do not serve the images, and why. One that never sent anything is none.
class ImuCoverage {
 public:
  /// The time between two images, by the IMU's clock.
  void add(const ImuBuffer& buffer, double t0, double t1);
  /// What to do about it; empty: most of the last 64 images had their samples.
  const std::string& problem() const { return problem_; }
  void reset() { *this = {}; }

 private:
  std::uint64_t missed_ = 0;  ///< a bit for each of the last images
  std::string problem_;
};

struct AttitudeSettings {
  double time_constant = 8.0;       ///< of the accelerometer's correction; shorter while the filter is young [s]
  double max_norm_deviation = 0.6;  ///< samples whose specific force differs more from gravity do not correct [m/s^2]
  double rest_seconds = 0.5;        ///< at rest: for this long [s]
  double rest_gyro_std = 0.02;      ///< the scatter of the rates stays below [rad/s]
  double rest_accel_std = 0.25;     ///< and that of the specific force [m/s^2]
  double rest_gyro_mean = 0.06;     ///< the mean rate, taken for the bias, is below this the first time [rad/s]
  double rest_gyro_change =
      0.008;  ///< and near the known bias, and the same in both halves of the time, afterwards [rad/s]
  double rest_accel_change = 0.06;  ///< specific force of the two halves of the time differs by less [m/s^2]
};

/// Complementary filter for the direction that is up in the IMU frame; estimates the gyro bias while at rest.
class AttitudeFilter {
 public:
  explicit AttitudeFilter(const AttitudeSettings& settings = {})
      : settings_(settings), window_(2 * settings.rest_seconds) {}

  /// Samples that are not finite or not newer are ignored. After a gap of kMaxAge it begins anew, but for the bias.
  void add(const ImuSample& sample);
  void reset();

  static constexpr double kMaxAge = 0.5;  ///< of an attitude; the robot may have turned since [s]

  bool initialized() const { return initialized_; }
  /// It is, and the last sample is not much older than `stamp`.
  bool knownAt(double stamp) const { return initialized_ && stamp - last_stamp_ < kMaxAge; }
  /// Unit, IMU frame, at the last sample: +z of a level frame. Zero before initialisation.
  Eigen::Vector3d up() const { return up_; }
  /// Standard deviation of `up` [rad], a rough figure: small at rest, larger under acceleration.
  double upSigma() const { return up_sigma_; }
  bool atRest() const { return at_rest_; }
  Eigen::Vector3d gyroBias() const { return gyro_bias_; }
  /// True once a rest gave a bias.
  bool biasKnown() const { return bias_known_; }
  /// From elsewhere, for example InertialAlignment. `certain`: within rest_gyro_change, so that rest is told by it.
  void setGyroBias(const Eigen::Vector3d& bias, bool certain = true);

 private:
  bool detectRest(const ImuBuffer::Mean& whole) const;

  AttitudeSettings settings_;
  ImuBuffer window_;
  bool initialized_ = false;
  bool at_rest_ = false;
  bool bias_known_ = false;
  Eigen::Vector3d up_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d gyro_bias_ = Eigen::Vector3d::Zero();
  double up_sigma_ = 0.1;
  double last_stamp_ = -1;
  double age_ = 0;           ///< since initialisation [s]
  double rest_samples_ = 0;  ///< of the present rest
};

}  // namespace visual_frontend
