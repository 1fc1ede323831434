// Preintegration of inertial samples between two images (Forster 2017): rotation, velocity and position deltas with
// covariance and first-order bias Jacobians.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "visual_frontend/imu_attitude.h"

namespace visual_frontend {

inline constexpr double kGravity = 9.81;  ///< [m/s^2]

struct ImuNoise {
  double gyro_density = 3e-4;     ///< [rad/s/sqrt(Hz)]
  double accel_density = 4e-3;    ///< [m/s^2/sqrt(Hz)]
  double gyro_bias_walk = 3e-5;   ///< [rad/s^2/sqrt(Hz)]
  double accel_bias_walk = 6e-4;  ///< [m/s^3/sqrt(Hz)]
  /// Throws std::invalid_argument, naming the field, when a value is not positive and finite.
  void validate() const;
};

/// As an IMU reads it whose axes are R_turned_imu from this one's.
inline ImuSample turned(const Eigen::Matrix3d& R_turned_imu, const ImuSample& s) {
  return {s.stamp, R_turned_imu * s.angular_velocity, R_turned_imu * s.specific_force};
}

struct ImuBias {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< [rad/s]
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< [m/s^2]
};

/// Motion of the IMU between two times, free of gravity and of the initial velocity. With R_i = R_map_imu at the start:
///   R_j = R_i dR;  v_j = v_i + g dt + R_i dv;  p_j = p_i + v_i dt + g dt^2 / 2 + R_i dp     (g = (0, 0, -9.81))
class Preintegration {
 public:
  Preintegration(const ImuNoise& noise, const ImuBias& bias);

  /// Advances from sample `a` to the later sample `b` by the midpoint rule. Throws std::invalid_argument unless a.stamp
  /// < b.stamp.
  void integrate(const ImuSample& a, const ImuSample& b);

  /// Integrates consecutive samples; fewer than two leave the deltas as they are.
  void integrate(const std::vector<ImuSample>& samples);

  double duration() const { return duration_; }  ///< [s]
  const ImuBias& bias() const { return bias_; }  ///< at which the samples were integrated
  const ImuNoise& noise() const { return noise_; }

  /// Deltas at another bias, to first order in the difference.
  Eigen::Matrix3d rotation(const ImuBias& bias) const;
  Eigen::Vector3d velocity(const ImuBias& bias) const;  ///< [m/s]
  Eigen::Vector3d position(const ImuBias& bias) const;  ///< [m]
  const Eigen::Matrix3d& rotation() const { return rotation_; }
  const Eigen::Vector3d& velocity() const { return velocity_; }
  const Eigen::Vector3d& position() const { return position_; }

  /// Covariance of (rotation, velocity, position): a right-multiplied rotation error [rad], then [m/s] and [m] in the
  /// first IMU frame.
  const Eigen::Matrix<double, 9, 9>& covariance() const { return covariance_; }
  /// d (rotation, velocity, position) / d (gyro bias, accel bias), rotation rows right-multiplied.
  const Eigen::Matrix<double, 9, 6>& biasJacobian() const { return bias_jacobian_; }
  const std::vector<ImuSample>& samples() const { return samples_; }

  /// The same samples and bias as an IMU reads them whose axes are R_turned_imu from this one's.
  Preintegration turned(const Eigen::Matrix3d& R_turned_imu) const;

  /// The same samples integrated at another bias.
  Preintegration reintegrated(const ImuBias& bias) const;

 private:
  ImuNoise noise_;
  ImuBias bias_;
  double duration_ = 0;
  Eigen::Matrix3d rotation_ = Eigen::Matrix3d::Identity();
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d position_ = Eigen::Vector3d::Zero();
  Eigen::Matrix<double, 9, 9> covariance_ = Eigen::Matrix<double, 9, 9>::Zero();
  Eigen::Matrix<double, 9, 6> bias_jacobian_ = Eigen::Matrix<double, 9, 6>::Zero();
  std::vector<ImuSample> samples_;
};

/// Samples of [begin, end] with linear interpolation at both ends, ready to integrate. Empty when begin >= end or the
/// samples leave a gap longer than max_gap [s] in the interval or at its ends (below that, the outermost sample holds).
std::vector<ImuSample> samplesBetween(const ImuBuffer& buffer, double begin, double end, double max_gap = 0.05);

}  // namespace visual_frontend
