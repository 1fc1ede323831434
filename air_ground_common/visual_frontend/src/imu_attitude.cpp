#include "visual_frontend/imu_attitude.h"

#include <algorithm>
#include <bitset>
#include <cmath>

#include "air_ground_common/imu_combiner.h"
#include "air_ground_common/text.h"
#include "visual_frontend/imu_preintegration.h"

namespace visual_frontend {

using air_ground_common::expSO3;

namespace {

// No robot turns or accelerates so differently from one sample to the next and back again: a byte was spoilt.
constexpr double kLeapSeconds = 0.03;  // a leap that lasts longer is believed, and no gap is longer
constexpr double kLeapRate = 5;        // [rad/s]
constexpr double kLeapForce = 100;     // [m/s^2]

bool leaps(const ImuSample& last, const ImuSample& sample) {
  return sample.stamp - last.stamp < kLeapSeconds &&
         ((sample.angular_velocity - last.angular_velocity).norm() > kLeapRate ||
          (sample.specific_force - last.specific_force).norm() > kLeapForce);
}

}  // namespace

bool ImuBuffer::add(const ImuSample& sample) {
  if (!std::isfinite(sample.stamp) || !(sample.angular_velocity.norm() <= air_ground_common::kMaxAngularVelocity) ||
      !(sample.specific_force.norm() <= air_ground_common::kMaxSpecificForce))
    return false;
  if (!samples_.empty() && (sample.stamp <= samples_.back().stamp || leaps(samples_.back(), sample))) return false;
  samples_.push_back(sample);
  while (samples_.size() > 2 && samples_.back().stamp - samples_.front().stamp > max_seconds_) samples_.pop_front();
  return true;
}

namespace {

auto firstNotBefore(const std::deque<ImuSample>& samples, double t) {
  return std::lower_bound(samples.begin(), samples.end(), t,
                          [](const ImuSample& s, double stamp) { return s.stamp < stamp; });
}

}  // namespace

bool ImuBuffer::covers(double t0, double t1, double max_gap) const {
  if (samples_.empty() || t1 < t0) return false;
  // The ends may lie outside the samples by less than the gap: the nearest rate then holds.
  if (samples_.front().stamp > t0 + max_gap || samples_.back().stamp < t1 - max_gap) return false;
  const auto end = samples_.end();
  auto it = firstNotBefore(samples_, t0);
  if (it != samples_.begin()) --it;
  for (auto next = it; next != end && it->stamp < t1; it = next) {
    if (++next == end) break;
    if (next->stamp - it->stamp > max_gap) return false;
  }
  return true;
}

std::optional<Eigen::Matrix3d> ImuBuffer::integrateRotation(double t0, double t1,
                                                            const Eigen::Vector3d& gyro_bias) const {
  if (!covers(t0, t1)) return std::nullopt;
  const auto rateAt = [&](double t) -> Eigen::Vector3d {
    const auto next = firstNotBefore(samples_, t);
    if (next == samples_.begin()) return next->angular_velocity;
    if (next == samples_.end()) return samples_.back().angular_velocity;
    const auto before = std::prev(next);
    const double s = (t - before->stamp) / (next->stamp - before->stamp);
    return (1 - s) * before->angular_velocity + s * next->angular_velocity;
  };
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  double t = t0;
  Eigen::Vector3d rate = rateAt(t0);
  const auto advance = [&](double stamp, const Eigen::Vector3d& next_rate) {
    R = R * expSO3((0.5 * (rate + next_rate) - gyro_bias) * (stamp - t));
    t = stamp;
    rate = next_rate;
  };
  for (auto it = firstNotBefore(samples_, t0); it != samples_.end() && it->stamp < t1; ++it)
    advance(it->stamp, it->angular_velocity);
  advance(t1, rateAt(t1));
  return R;
}

ImuBuffer::Mean ImuBuffer::mean(double t0, double t1) const {
  Mean m;
  const auto begin = firstNotBefore(samples_, t0);
  for (auto it = begin; it != samples_.end() && it->stamp <= t1; ++it) {
    ++m.count;
    m.angular_velocity += it->angular_velocity;
    m.specific_force += it->specific_force;
  }
  if (m.count == 0) return m;
  m.angular_velocity /= m.count;
  m.specific_force /= m.count;
  double rate2 = 0, force2 = 0;
  for (auto it = begin; it != samples_.end() && it->stamp <= t1; ++it) {
    rate2 += (it->angular_velocity - m.angular_velocity).squaredNorm();
    force2 += (it->specific_force - m.specific_force).squaredNorm();
  }
  m.angular_velocity_std = std::sqrt(rate2 / m.count);
  m.specific_force_std = std::sqrt(force2 / m.count);
  return m;
}

void ImuCoverage::add(const ImuBuffer& buffer, double t0, double t1) {
  constexpr double kSteadyRate = 25;  // [Hz]; slower, even small delays leave gaps that are not bridged
  constexpr double kEnds = 0.1;       // before or after an image, samples are of another time [s]
  if (buffer.empty()) return;
  const bool missed = !buffer.covers(t0, t1);
  missed_ = missed_ << 1 | static_cast<std::uint64_t>(missed);
  if (std::bitset<64>(missed_).count() < 32) {
    problem_.clear();
    return;
  }
  if (!missed) return;
  using air_ground_common::formatted;
  const double first = buffer.samples().front().stamp, last = buffer.samples().back().stamp;
  const double rate = static_cast<double>(buffer.samples().size() - 1) / std::max(last - first, 1e-9);
  if (last > first && rate < kSteadyRate)
    problem_ = formatted(
        "IMU at %.0f Hz: steadily more than 20 Hz are needed, 100 Hz are better: raise the rate of its driver", rate);
  else if (last < t1 - kEnds)
    problem_ = formatted(
        "the IMU's stamps end %.1f s before the images': one clock is needed for both, and an IMU that goes on sending",
        t1 - last);
  else if (first > t0 + kEnds)
    problem_ = formatted("the IMU's stamps are %.1f s ahead of the images': one clock is needed for both", first - t0);
  else
    problem_ = formatted(
        "IMU at %.0f Hz, with gaps of more than 0.05 s at most of the images: see to its driver and connection", rate);
}

bool AttitudeFilter::detectRest(const ImuBuffer::Mean& m) const {
  if (m.count < 10 || m.angular_velocity_std > settings_.rest_gyro_std ||
      m.specific_force_std > settings_.rest_accel_std ||
      std::abs(m.specific_force.norm() - kGravity) > settings_.max_norm_deviation) {
    return false;
  }
  if (bias_known_ ? (m.angular_velocity - gyro_bias_).norm() > settings_.rest_gyro_change
                  : m.angular_velocity.norm() > settings_.rest_gyro_mean)
    return false;
  // A robot that sets off smoothly scatters little but changes from one half of the window to the other.
  const double middle = last_stamp_ - 0.5 * settings_.rest_seconds;
  const ImuBuffer::Mean first = window_.mean(last_stamp_ - settings_.rest_seconds, middle),
                        second = window_.mean(middle, last_stamp_);
  return (first.angular_velocity - second.angular_velocity).norm() < settings_.rest_gyro_change &&
         (first.specific_force - second.specific_force).norm() < settings_.rest_accel_change;
}

void AttitudeFilter::add(const ImuSample& sample) {
  if (!window_.add(sample)) return;
  const double dt = last_stamp_ >= 0 ? sample.stamp - last_stamp_ : 0;
  last_stamp_ = sample.stamp;
  if (dt >= kMaxAge) {
    initialized_ = false;
    up_.setZero();
    window_.clear();
    window_.add(sample);
  }
  const ImuBuffer::Mean m = window_.mean(sample.stamp - settings_.rest_seconds, sample.stamp);
  at_rest_ = sample.stamp - window_.samples().front().stamp >= settings_.rest_seconds && detectRest(m);
  if (at_rest_) {
    rest_samples_ = std::min(rest_samples_ + 1, 2000.0);
    // Means over the rest so far; a new rest starts from its own window.
    const double gain = std::max(1.0 / rest_samples_, 0.002);
    gyro_bias_ = bias_known_ ? Eigen::Vector3d(gyro_bias_ + std::min(gain, 0.02) * (m.angular_velocity - gyro_bias_))
                             : m.angular_velocity;
    bias_known_ = true;
    up_ = (initialized_ ? Eigen::Vector3d(up_ + gain * (m.specific_force.normalized() - up_)) : m.specific_force)
              .normalized();
    up_sigma_ = 0.01;  // the accelerometer's own bias: 0.1 m/s^2 of consumer sensors
    age_ = std::max(age_, settings_.time_constant);
    initialized_ = true;
    return;
  }
  rest_samples_ = 0;
  const double norm = sample.specific_force.norm();
  if (!initialized_) {
    if (m.count < 10 || std::abs(m.specific_force.norm() - kGravity) > 2 * settings_.max_norm_deviation) return;
    up_ = m.specific_force.normalized();
    up_sigma_ = 0.1;
    age_ = 0;
    initialized_ = true;
    return;
  }
  // A direction fixed in the world turns against the body: du/dt = -omega x u.
  up_ = expSO3(-(sample.angular_velocity - gyro_bias_) * dt) * up_;
  age_ += dt;
  if (norm > 1e-3 && std::abs(norm - kGravity) < settings_.max_norm_deviation) {
    // Young, the filter averages all it has seen.
    const double gain = std::min(1.0, dt / std::min(settings_.time_constant, age_ + 0.2));
    up_ += gain * (sample.specific_force / norm - up_);
    // Towards the error that accelerations of this size leave after the filter.
    up_sigma_ += gain * (0.03 - up_sigma_);
  } else {
    up_sigma_ = std::min(0.3, up_sigma_ + 0.01 * dt);
  }
  up_.normalize();
}

void AttitudeFilter::setGyroBias(const Eigen::Vector3d& bias, bool certain) {
  gyro_bias_ = bias;
  bias_known_ = bias_known_ || certain;
}

void AttitudeFilter::reset() {
  const AttitudeSettings settings = settings_;
  *this = AttitudeFilter(settings);
}

}  // namespace visual_frontend
