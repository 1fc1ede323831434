#include "map_level.h"

#include <algorithm>
#include <cmath>

namespace rgbd_slam {

namespace {

constexpr double kUpForKeyframes = 0.01;  // [rad]; known so well, gravity holds the keyframes
constexpr double kSurfaces = 0.02;        // by how much what lies flat leans, and a depth camera bends it [rad]
constexpr double kSureOfTilt = 3;         // standard deviations, while the direction is still getting better

}  // namespace

void MapLevel::begin(const visual_frontend::AttitudeFilter* attitude) {
  known_ = attitude != nullptr;
  by_surfaces_ = false;
  // Begun in motion, the first direction is coarse: update looks again when more is known.
  settled_ = !attitude || attitude->atRest();
  sigma_ = attitude ? attitude->upSigma() : kNoGravity;
  vertical_ = {Eigen::Vector3d::UnitZ(), sigma_};
}

void MapLevel::distrust(const Pose& T_map_first_base) {
  if (!known_) return;
  known_ = false;
  const Eigen::Vector3d up = T_map_first_base.linear().col(2);
  sigma_ = std::hypot(kNoGravity, std::atan2(up.head<2>().norm(), up.z()));
  vertical_ = {Eigen::Vector3d::UnitZ(), sigma_};
}

std::optional<std::pair<Eigen::Vector3d, double>> MapLevel::upInCamera(double stamp,
                                                                       const Eigen::Matrix3d& R_map_camera,
                                                                       const CameraMotion& motion) const {
  const visual_frontend::AttitudeFilter& attitude = motion.attitude();
  if (!settings_.use_gravity || !known_ || !motion.upKnownAt(stamp)) return std::nullopt;
  const auto estimate = motion.estimate();
  if (estimate && estimate->up_sigma < kUpForKeyframes)
    return std::make_pair(Eigen::Vector3d(R_map_camera.transpose() * estimate->up), kUpForKeyframes);
  // In a curve the accelerometer leans for as long as the curve lasts.
  return std::make_pair(motion.upInCamera(), attitude.atRest() ? 1.5 * attitude.upSigma()
                                                               : std::max(settings_.gravity_sigma, attitude.upSigma()));
}

std::optional<MapLevel::Correction> MapLevel::update(double stamp, const CameraMotion& motion, const Pose& T_map_camera,
                                                     const Pose& T_map_first_base) {
  if (!motion.hasImu() || !known_) return std::nullopt;
  const visual_frontend::AttitudeFilter& attitude = motion.attitude();
  Vertical now;
  const auto estimate = motion.estimate();
  const bool rest = !settled_ && motion.upKnownAt(stamp) && attitude.atRest();
  if (estimate && (!rest || estimate->up_sigma < attitude.upSigma()))
    now = {estimate->up, estimate->up_sigma};
  else if (rest)
    now = {T_map_camera.linear() * motion.upInCamera(), attitude.upSigma()};
  else
    return std::nullopt;
  const double angle = std::atan2(now.up.head<2>().norm(), now.up.z());
  vertical_ = now;
  // What is not corrected counts as uncertainty of the poses.
  if (now.stddev < sigma_) sigma_ = std::hypot(now.stddev, angle);
  const bool certain = rest || now.stddev < settings_.level_tolerance / 2;
  const bool settled_before = settled_;
  settled_ = settled_ || certain;
  if (angle < settings_.level_tolerance || !(certain || angle > kSureOfTilt * now.stddev)) return std::nullopt;
  const Eigen::Matrix3d R = levelling(now.up, T_map_first_base);
  vertical_.up = R * now.up;
  sigma_ = now.stddev;
  return Correction{R, !settled_before};
}

std::optional<MapLevel::Correction> MapLevel::takeSurfaces(const Eigen::Vector3d& up, const Pose& T_map_first_base) {
  if (known_) return std::nullopt;
  by_surfaces_ = true;
  const double angle = std::atan2(up.head<2>().norm(), up.z());
  vertical_ = {up, kSurfaces};
  sigma_ = std::hypot(kSurfaces, angle);
  if (angle < 1.5 * kSurfaces) return std::nullopt;
  const Eigen::Matrix3d R = levelling(up, T_map_first_base);
  vertical_.up = R * up;
  sigma_ = kSurfaces;
  return Correction{R, false};
}

// Level, with the first base's yaw as it was.
Eigen::Matrix3d MapLevel::levelling(const Eigen::Vector3d& up, const Pose& T_map_first_base) {
  const Eigen::Matrix3d R = air_ground_common::levelingRotation(up);
  return Eigen::AngleAxisd(-air_ground_common::yawOf(R * T_map_first_base.linear()), Eigen::Vector3d::UnitZ()) * R;
}

}  // namespace rgbd_slam
