#include "ekf_tracker/tilt_filter.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/geometry.h"
#include "ekf_tracker/tilt_source.h"

namespace ekf_tracker {
namespace {

constexpr double kDrift = 0.002;        // of the odometry's turns [rad/sqrt(s)]
constexpr double kForceTime = 2;        // over which forces are averaged to one vertical [s]
constexpr double kForceStddev = 0.05;   // of that: 0.5 m/s^2 that do not average out [rad]
constexpr double kTolerance = 0.1;      // between a measurement and a stamp of the odometry [s]
constexpr std::size_t kWaiting = 6000;  // half a minute of accelerations

}  // namespace

void TiltFilter::turn(double previous_stamp, double stamp, const Eigen::Matrix3d& R_previous_current) {
  if (!std::isfinite(stamp) || !std::isfinite(previous_stamp) || !R_previous_current.allFinite()) return;
  const double newest = R_first_body_.newest();
  if (stamp <= newest && stamp > newest - 1) return;
  Eigen::Quaterniond R = Eigen::Quaterniond::Identity();
  if (std::abs(previous_stamp - newest) <= TiltSource::kSameStamp) {
    R = *R_first_body_.nearest(newest, TiltSource::kSameStamp);
    variance_ += kDrift * kDrift * (stamp - newest);
  } else {
    R_first_body_.clear();
    R_first_body_.add(previous_stamp, R);
    variance_ = std::numeric_limits<double>::infinity();
    force_count_ = 0;
  }
  R_first_body_.add(stamp, (R * Eigen::Quaterniond(R_previous_current)).normalized());
  while (!verticals_.empty() && verticals_.front().stamp <= stamp) {
    correct(verticals_.front());
    verticals_.pop_front();
  }
  averageForces();
}

void TiltFilter::addVertical(double stamp, const Eigen::Vector3d& up_body, double stddev) {
  if (!std::isfinite(stamp) || !up_body.allFinite() || !(up_body.norm() > 0) || !(stddev > 0)) return;
  if (stamp <= R_first_body_.newest()) return correct({stamp, up_body, stddev});
  while (!verticals_.empty() && verticals_.back().stamp > stamp) verticals_.pop_back();
  verticals_.push_back({stamp, up_body, stddev});
  if (verticals_.size() > kWaiting) verticals_.pop_front();
}

void TiltFilter::addSpecificForce(double stamp, const Eigen::Vector3d& force_body) {
  if (!std::isfinite(stamp) || !force_body.allFinite()) return;
  if (!forces_.empty() && stamp < forces_.back().first) forces_.clear();
  forces_.emplace_back(stamp, force_body);
  if (forces_.size() > kWaiting) forces_.pop_front();
}

void TiltFilter::correct(const Vertical& measured) {
  const Eigen::Quaterniond* R = R_first_body_.nearest(measured.stamp, kTolerance);
  if (!R) return;
  const Eigen::Vector3d up = *R * measured.up_body.normalized();
  double variance = measured.stddev * measured.stddev;
  if (!std::isfinite(variance_)) {
    up_first_ = up;
    variance_ = variance;
    return;
  }
  constexpr double kSquaredGate = 9;
  const double angle = std::acos(std::clamp(up.dot(up_first_), -1.0, 1.0));
  variance *= std::max(1.0, angle * angle / (kSquaredGate * (variance_ + variance)));
  const double gain = variance_ / (variance_ + variance);
  const Eigen::Vector3d axis = up_first_.cross(up);
  if (axis.norm() > 1e-9) up_first_ = Eigen::AngleAxisd(gain * angle, axis.normalized()) * up_first_;
  variance_ *= 1 - gain;
}

void TiltFilter::averageForces() {
  for (; !forces_.empty() && forces_.front().first <= R_first_body_.newest(); forces_.pop_front()) {
    const auto& [stamp, force_body] = forces_.front();
    const Eigen::Quaterniond* R = R_first_body_.nearest(stamp, kTolerance);
    if (!R) continue;
    if (force_count_ == 0 || stamp < force_begin_ || stamp > force_begin_ + 2 * kForceTime) {
      force_begin_ = stamp;
      force_count_ = 0;
      force_sum_.setZero();
    }
    force_sum_ += *R * force_body;
    ++force_count_;
    if (stamp < force_begin_ + kForceTime) continue;
    const Eigen::Vector3d mean = force_sum_ / force_count_;
    force_count_ = 0;
    if (TiltSource::isGravity(mean)) correct({stamp, R->conjugate() * mean, kForceStddev});
  }
}

std::optional<Tilt> TiltFilter::at(double stamp, double tolerance) const {
  const Eigen::Quaterniond* R = R_first_body_.nearest(stamp, tolerance);
  if (!R || !std::isfinite(variance_)) return std::nullopt;
  return Tilt{tiltOf(air_ground_common::levelingRotation(R->conjugate() * up_first_)), std::sqrt(variance_)};
}

}  // namespace ekf_tracker
