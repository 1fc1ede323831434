#include "visual_frontend/imu_preintegration.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "air_ground_common/geometry.h"

namespace visual_frontend {

namespace {

// Where samples are missing, what the vehicle did between is a random walk pinned at both ends, whose mean has the
// variance q dt / 12. A MAV changes by about 0.3 rad/s and 1 m/s^2 in a tenth of a second.
constexpr double kUnseen = 0.025;                   // an ordinary IMU's samples are no further apart [s]
constexpr double kTurnWalk = 0.9, kForceWalk = 10;  // q [rad^2/s^3], [m^2/s^5]

}  // namespace

using air_ground_common::expSO3;
using air_ground_common::rightJacobianSO3;
using air_ground_common::skew;

void ImuNoise::validate() const {
  const auto check = [](double value, const char* name) {
    if (!(value > 0) || !std::isfinite(value))
      throw std::invalid_argument(std::string("ImuNoise: ") + name + " must be positive, is " + std::to_string(value));
  };
  check(gyro_density, "gyro_density");
  check(accel_density, "accel_density");
  check(gyro_bias_walk, "gyro_bias_walk");
  check(accel_bias_walk, "accel_bias_walk");
}

Preintegration::Preintegration(const ImuNoise& noise, const ImuBias& bias) : noise_(noise), bias_(bias) {}

void Preintegration::integrate(const ImuSample& a, const ImuSample& b) {
  const double dt = b.stamp - a.stamp;
  if (!(dt > 0)) throw std::invalid_argument("Preintegration: samples must have increasing stamps");
  if (samples_.empty()) samples_.push_back(a);
  samples_.push_back(b);

  const Eigen::Vector3d w_dt = (0.5 * (a.angular_velocity + b.angular_velocity) - bias_.gyro) * dt;
  const Eigen::Vector3d force_a = a.specific_force - bias_.accel, force_b = b.specific_force - bias_.accel;
  const Eigen::Matrix3d step = expSO3(w_dt), J_r = rightJacobianSO3(w_dt);
  const Eigen::Matrix3d R0 = rotation_, R1 = rotation_ * step;
  const Eigen::Vector3d acceleration = 0.5 * (R0 * force_a + R1 * force_b);

  // Linearised step in (rotation, velocity, position); the acceleration sees the rotation at both ends.
  const Eigen::Matrix3d dR_bg = -J_r * dt;
  const Eigen::Matrix3d lever = -0.5 * R1 * skew(force_b);
  const Eigen::Matrix3d da_dtheta = -0.5 * R0 * skew(force_a) + lever * step.transpose();
  const Eigen::Matrix3d da_dbg = lever * dR_bg;
  const Eigen::Matrix3d da_dba = -0.5 * (R0 + R1);
  const double half_dt2 = 0.5 * dt * dt;
  Eigen::Matrix<double, 9, 9> F = Eigen::Matrix<double, 9, 9>::Identity();
  F.block<3, 3>(0, 0) = step.transpose();
  F.block<3, 3>(3, 0) = da_dtheta * dt;
  F.block<3, 3>(6, 0) = da_dtheta * half_dt2;
  F.block<3, 3>(6, 3) = Eigen::Matrix3d::Identity() * dt;
  Eigen::Matrix<double, 9, 6> G = Eigen::Matrix<double, 9, 6>::Zero();
  G.block<3, 3>(0, 0) = dR_bg;
  G.block<3, 3>(3, 0) = da_dbg * dt;
  G.block<3, 3>(6, 0) = da_dbg * half_dt2;
  G.block<3, 3>(3, 3) = da_dba * dt;
  G.block<3, 3>(6, 3) = da_dba * half_dt2;

  // White noise enters where the biases do, with variance density^2 / dt over the step.
  Eigen::Matrix<double, 6, 1> variance;
  const double unseen = dt > kUnseen ? dt / 12 : 0;
  variance << Eigen::Vector3d::Constant(noise_.gyro_density * noise_.gyro_density / dt + kTurnWalk * unseen),
      Eigen::Vector3d::Constant(noise_.accel_density * noise_.accel_density / dt + kForceWalk * unseen);
  covariance_ = F * covariance_ * F.transpose() + G * variance.asDiagonal() * G.transpose();
  bias_jacobian_ = F * bias_jacobian_ + G;

  position_ += velocity_ * dt + half_dt2 * acceleration;
  velocity_ += acceleration * dt;
  rotation_ = Eigen::Quaterniond(R1).normalized().toRotationMatrix();
  duration_ += dt;
}

void Preintegration::integrate(const std::vector<ImuSample>& samples) {
  for (std::size_t i = 1; i < samples.size(); ++i) integrate(samples[i - 1], samples[i]);
}

Eigen::Matrix3d Preintegration::rotation(const ImuBias& bias) const {
  return rotation_ * expSO3(bias_jacobian_.block<3, 3>(0, 0) * (bias.gyro - bias_.gyro));
}

Eigen::Vector3d Preintegration::velocity(const ImuBias& bias) const {
  return velocity_ + bias_jacobian_.block<3, 3>(3, 0) * (bias.gyro - bias_.gyro) +
         bias_jacobian_.block<3, 3>(3, 3) * (bias.accel - bias_.accel);
}

Eigen::Vector3d Preintegration::position(const ImuBias& bias) const {
  return position_ + bias_jacobian_.block<3, 3>(6, 0) * (bias.gyro - bias_.gyro) +
         bias_jacobian_.block<3, 3>(6, 3) * (bias.accel - bias_.accel);
}

Preintegration Preintegration::reintegrated(const ImuBias& bias) const {
  Preintegration result(noise_, bias);
  result.integrate(samples_);
  return result;
}

Preintegration Preintegration::turned(const Eigen::Matrix3d& R_turned_imu) const {
  Preintegration result(noise_, {R_turned_imu * bias_.gyro, R_turned_imu * bias_.accel});
  std::vector<ImuSample> samples;
  for (const ImuSample& s : samples_) samples.push_back(visual_frontend::turned(R_turned_imu, s));
  result.integrate(samples);
  return result;
}

std::vector<ImuSample> samplesBetween(const ImuBuffer& buffer, double begin, double end, double max_gap) {
  if (!(begin < end) || !buffer.covers(begin, end, max_gap)) return {};
  const auto& samples = buffer.samples();
  const auto at = [&](double stamp) {
    const auto later = std::lower_bound(samples.begin(), samples.end(), stamp,
                                        [](const ImuSample& s, double t) { return s.stamp < t; });
    // The buffer may end short of the interval by less than the gap: its outermost samples then hold.
    if (later == samples.begin() || later == samples.end()) {
      ImuSample held = later == samples.end() ? samples.back() : *later;
      held.stamp = stamp;
      return held;
    }
    const ImuSample& a = *(later - 1);
    const double s = (stamp - a.stamp) / (later->stamp - a.stamp);
    return ImuSample{stamp, (1 - s) * a.angular_velocity + s * later->angular_velocity,
                     (1 - s) * a.specific_force + s * later->specific_force};
  };
  std::vector<ImuSample> cut{at(begin)};
  auto it =
      std::upper_bound(samples.begin(), samples.end(), begin, [](double t, const ImuSample& s) { return t < s.stamp; });
  for (; it != samples.end() && it->stamp < end; ++it) cut.push_back(*it);
  cut.push_back(at(end));
  return cut;
}

}  // namespace visual_frontend
