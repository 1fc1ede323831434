#include "ekf_tracker/tilt_source.h"

#include <Eigen/Geometry>

namespace ekf_tracker {

using air_ground_common::Pose;

Eigen::Matrix3d tiltOf(const Eigen::Matrix3d& R_level_body) {
  return Eigen::AngleAxisd(-air_ground_common::yawOf(R_level_body), Eigen::Vector3d::UnitZ()).toRotationMatrix() *
         R_level_body;
}

void TiltSource::addPose(double stamp, const Pose& T_map_base) {
  if (stamp < poses_.newest() - 1.0) poses_.clear();
  poses_.add(stamp, T_map_base);
}

void TiltSource::addSpecificForce(double stamp, const Eigen::Vector3d& force_base) {
  const double dt = up_stamp_ ? stamp - *up_stamp_ : 0;
  up_stamp_ = stamp;
  const double share = dt > 0 && dt < 1 ? dt : 1;
  up_base_ = share >= 1 ? force_base : Eigen::Vector3d(up_base_ + share * (force_base - up_base_));
  if (isGravity(up_base_))
    odd_since_.reset();
  else if (!odd_since_ || stamp < *odd_since_)
    odd_since_ = stamp;
  if (stamp < ups_.newest()) ups_.clear();
  if (stamp >= ups_.newest() + kTiltInterval) ups_.add(stamp, up_base_);
}

std::optional<Pose> TiltSource::poseAt(double stamp, double tolerance) const {
  const Pose* pose = poses_.nearest(stamp, tolerance);
  return pose ? std::optional<Pose>(*pose) : std::nullopt;
}

std::optional<Eigen::Matrix3d> TiltSource::accelerometerTiltAt(double stamp) const {
  const Eigen::Vector3d* up = ups_.nearest(stamp, kTiltTolerance);
  if (!up || !isGravity(*up)) return std::nullopt;
  return tiltOf(air_ground_common::levelingRotation(*up));
}

bool TiltSource::isGravity(const Eigen::Vector3d& force) {
  return force.norm() >= kLeastGravity && force.norm() <= kMostGravity;
}

bool TiltSource::lacksGravity() const { return odd_since_ && *up_stamp_ - *odd_since_ > kLongestManoeuvre; }

void TiltSource::clear() {
  poses_.clear();
  ups_.clear();
  up_base_.setZero();
  up_stamp_.reset();
  odd_since_.reset();
}

}  // namespace ekf_tracker
