#include "ekf_tracker/tilt_filter.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {
namespace {

constexpr double kDrift = 0.002;         // of the odometry's turns [rad/sqrt(s)]
constexpr double kPauseTurn = 0.3;       // how fast it may turn while the odometry pauses [rad/s], ...
constexpr double kLongestPause = 1;      // ... for so long [s]
constexpr double kForceTime = 2;         // over which forces are averaged to one vertical [s]
constexpr double kForceTolerance = 0.1;  // between a force and a stamp of the odometry [s]
constexpr double kBias = 0.03;           // of the accelerometer: 0.3 m/s^2 [rad]
constexpr double kLeast = 0.01;          // fixes err alike: no number of them tells more [rad]
constexpr double kGate = 9;              // three standard deviations, squared
constexpr int kInARow = 3;               // fixes that contradict what is known, and prevail
constexpr std::size_t kWaiting = 6000;   // half a minute of accelerations at 200 Hz

}  // namespace

void TiltFilter::turn(double previous_stamp, double stamp, const Eigen::Matrix3d& R_previous_current) {
  if (!std::isfinite(previous_stamp) || !(stamp > previous_stamp) || !R_previous_current.allFinite()) return;
  const double newest = R_first_body_.newest(), pause = previous_stamp - newest;
  if (stamp <= newest && stamp > newest - 1) return;
  Eigen::Quaterniond R = Eigen::Quaterniond::Identity();
  if (std::abs(pause) <= kLongestPause && stamp > newest) {
    if (pause < -TiltSource::kSameStamp) return;  // of a time that is covered in part
    R = *R_first_body_.nearest(newest, TiltSource::kSameStamp);
    variance_ += kDrift * kDrift * (stamp - newest);
    if (pause > TiltSource::kSameStamp) variance_ += std::pow(kPauseTurn * pause, 2);
  } else {
    R_first_body_.clear();
    variance_ = std::numeric_limits<double>::infinity();
    force_count_ = contradictions_ = 0;
  }
  R_first_body_.add(previous_stamp, R);
  R_first_body_.add(stamp, (R * Eigen::Quaterniond(R_previous_current)).normalized());
  for (; !verticals_.empty() && verticals_.front().stamp <= stamp; verticals_.pop_front())
    correctByFix(verticals_.front());
  correctByForces();
}

void TiltFilter::addVertical(const Vertical& vertical) {
  if (!std::isfinite(vertical.stamp) || !vertical.up_body.allFinite() || !(vertical.up_body.norm() > 0) ||
      !(vertical.stddev > 0))
    return;
  if (vertical.stamp <= R_first_body_.newest()) return correctByFix(vertical);
  while (!verticals_.empty() && verticals_.back().stamp > vertical.stamp) verticals_.pop_back();
  verticals_.push_back(vertical);
  if (verticals_.size() > kWaiting) verticals_.pop_front();
}

void TiltFilter::addSpecificForce(double stamp, const Eigen::Vector3d& force_body) {
  if (!std::isfinite(stamp) || !force_body.allFinite()) return;
  if (!forces_.empty() && stamp < forces_.back().first) forces_.clear();
  forces_.emplace_back(stamp, force_body);
  if (forces_.size() > kWaiting) forces_.pop_front();
}

void TiltFilter::correctByFix(const Vertical& vertical) {
  const Eigen::Quaterniond* R = R_first_body_.nearest(vertical.stamp, TiltSource::kSameStamp);
  if (!R) return;
  const Eigen::Vector3d up = *R * vertical.up_body.normalized();
  const double variance = std::pow(std::max(kLeast, vertical.stddev), 2);
  if (std::isfinite(variance_) && nis(up, variance) > kGate) {
    if (++contradictions_ == kInARow) set(up, variance, 0);
    return;
  }
  contradictions_ = 0;
  correct(up, variance, 0);
}

void TiltFilter::correctByForces() {
  constexpr double kVariance = kForceStddev * kForceStddev;
  for (; !forces_.empty() && forces_.front().first <= R_first_body_.newest(); forces_.pop_front()) {
    const auto& [stamp, force_body] = forces_.front();
    const Eigen::Quaterniond* R = R_first_body_.nearest(stamp, kForceTolerance);
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
    if (!TiltSource::isGravity(mean)) continue;
    // A long manoeuvre counts the less, the farther it leans.
    const Eigen::Vector3d up = mean.normalized();
    correct(up, kVariance * (std::isfinite(variance_) ? std::max(1.0, nis(up, kVariance) / kGate) : 1), 1);
  }
}

double TiltFilter::angleTo(const Eigen::Vector3d& up_first) const {
  return std::acos(std::clamp(up_first.dot(up_first_), -1.0, 1.0));
}

double TiltFilter::nis(const Eigen::Vector3d& up_first, double variance) const {
  return std::pow(angleTo(up_first), 2) / (variance_ + std::pow(kBias * force_share_, 2) + variance);
}

void TiltFilter::set(const Eigen::Vector3d& up_first, double variance, double force_share) {
  up_first_ = up_first;
  variance_ = variance;
  force_share_ = force_share;
  contradictions_ = 0;
}

void TiltFilter::correct(const Eigen::Vector3d& up_first, double variance, double force_share) {
  if (!std::isfinite(variance_)) return set(up_first, variance, force_share);
  // The bias is no noise: a fix sees it, more forces do not.
  const double known = variance_ + std::pow(kBias * std::max(0.0, force_share_ - force_share), 2);
  const double gain = known / (known + variance);
  const Eigen::Vector3d axis = up_first_.cross(up_first);
  if (axis.norm() > 1e-9) up_first_ = Eigen::AngleAxisd(gain * angleTo(up_first), axis.normalized()) * up_first_;
  variance_ = std::pow(1 - gain, 2) * variance_ + gain * gain * variance;
  force_share_ += gain * (force_share - force_share_);
}

std::optional<Tilt> TiltFilter::at(double stamp, double tolerance) const {
  const Eigen::Quaterniond* R = R_first_body_.nearest(stamp, tolerance);
  if (!R || !std::isfinite(variance_)) return std::nullopt;
  return Tilt{tiltOf(air_ground_common::levelingRotation(R->conjugate() * up_first_)),
              std::hypot(std::sqrt(variance_), kBias * force_share_, kLeast)};
}

}  // namespace ekf_tracker
