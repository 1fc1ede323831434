// Which way is up: from rest at the start, then from the motion that camera and IMU agree on.
#include <cmath>

#include "slam_impl.h"

namespace rgbd_slam {

namespace {

constexpr double kUpForKeyframes = 0.01;  // [rad]; known so well, gravity holds the keyframes
constexpr double kSureOfTilt = 3;         // standard deviations, while the direction is still getting better

}  // namespace

std::optional<std::pair<Eigen::Vector3d, double>> Slam::Impl::upOfCamera(const Eigen::Matrix3d& R_map_camera) const {
  if (!settings.use_gravity || !gravity_known || !motion.attitude().initialized()) return std::nullopt;
  const auto estimate = motion.estimate();
  if (estimate && estimate->up_sigma < kUpForKeyframes)
    return std::make_pair(Eigen::Vector3d(R_map_camera.transpose() * estimate->up), kUpForKeyframes);
  const visual_frontend::AttitudeFilter& attitude = motion.attitude();
  // In a curve the accelerometer leans for as long as the curve lasts.
  return std::make_pair(motion.upInCamera(), attitude.atRest() ? 1.5 * attitude.upSigma()
                                                               : std::max(settings.gravity_sigma, attitude.upSigma()));
}

bool Slam::Impl::levelMap() {
  if (!motion.hasImu() || !gravity_known) return false;
  const visual_frontend::AttitudeFilter& attitude = motion.attitude();
  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  double sigma = 0;
  const auto estimate = motion.estimate();
  const bool rest = !leveled && attitude.atRest();
  if (estimate && (!rest || estimate->up_sigma < attitude.upSigma())) {
    up = estimate->up;
    sigma = estimate->up_sigma;
  } else if (rest) {
    up = lastPose().linear() * motion.upInCamera();
    sigma = attitude.upSigma();
  } else {
    return false;
  }
  const double angle = std::atan2(up.head<2>().norm(), up.z());
  vertical = {up, sigma};
  // What is not corrected counts as uncertainty of the poses.
  if (sigma < tilt_sigma) tilt_sigma = std::hypot(sigma, angle);
  const bool certain = rest || sigma < settings.level_tolerance / 2;
  if (angle < settings.level_tolerance || !(certain || angle > kSureOfTilt * sigma)) {
    leveled = leveled || certain;
    return false;
  }
  // About the map's origin, keeping its yaw.
  air_ground_common::Similarity S;
  S.R = air_ground_common::levelingRotation(up);
  const Pose T_first = map.keyframes().begin()->second.T_map_camera * T_camera_base;
  S.R = Eigen::AngleAxisd(-air_ground_common::yawOf(S.R * T_first.linear()), Eigen::Vector3d::UnitZ()) * S.R;
  map.transform(S);
  motion.turn(S.R);
  vertical.up = S.R * up;
  if (!leveled) {
    // Directions taken while the map leaned were of an accelerometer in motion.
    for (const auto& entry : map.keyframes()) map.keyframe(entry.first).up_camera.reset();
  }
  leveled = leveled || certain;
  tilt_sigma = sigma;
  return true;
}

}  // namespace rgbd_slam
