#include "calibration_alignment.h"

namespace mav_vo {

using visual_frontend::BundleJob;
using visual_frontend::CameraVelocity;
using visual_frontend::Keyframe;
using visual_frontend::kNoLandmark;
using visual_frontend::LandmarkId;
using visual_frontend::Map;

namespace {

constexpr double kHeld = 1e-9;        // standard deviation of what is not estimated
constexpr double kRadialStep = 1e-4;  // of the numeric derivative

/// A landmark in a keyframe's camera; behind it where it is not known.
Eigen::Vector3d inCamera(const Map& map, const Keyframe& keyframe, LandmarkId landmark) {
  if (landmark == kNoLandmark || !map.hasLandmark(landmark)) return -Eigen::Vector3d::UnitZ();
  return keyframe.T_map_camera.inverse() * map.landmark(landmark).position;
}

double inverseDepth(const Eigen::Vector3d& p_camera) { return p_camera.z() > 0 ? 1 / p_camera.z() : 0; }

/// Where a point lies in the middle row's view, by the readout time [1/s].
Eigen::Vector2d byReadout(double row, const Eigen::Vector3d& p_camera, const CameraVelocity& moved) {
  const Eigen::Vector3d ray = p_camera / p_camera.z();
  const Eigen::Vector3d shift = row * (moved.angular.cross(ray) + moved.linear / p_camera.z());
  return shift.head<2>() - ray.head<2>() * shift.z();
}

}  // namespace

CalibrationAlignment::CalibrationAlignment(const CameraModel& camera, const OdometrySettings& settings)
    : camera_(camera),
      estimates_(settings.radial_stddev > 0 || (!settings.use_imu && settings.readout_time_stddev > 0)),
      readout_time_(settings.readout_time) {
  sigma_ << settings.radial_stddev, settings.use_imu ? 0 : settings.readout_time_stddev;
  sigma_ = sigma_.cwiseMax(kHeld).eval();
  mean_.setZero();
}

void CalibrationAlignment::open(const FrameTrajectory& frames, const Map& map, BundleJob* job) const {
  job->problem.calibration.emplace();
  job->problem.calibration->mean = mean_;
  job->problem.calibration->sigma = sigma_;
  const CameraModel other = visual_frontend::withRadial(camera_, kRadialStep);
  std::vector<std::optional<CameraVelocity>> moved;
  for (const auto id : job->keyframes) moved.push_back(frames.velocityAt(map.keyframe(id).stamp, map));
  for (std::size_t i = 0; i < job->problem.measurements.size(); ++i) {
    auto& m = job->problem.measurements[i];
    const Eigen::Vector3d p_camera = inCamera(map, map.keyframe(job->sources[i].keyframe), job->landmarks[m.point]);
    const auto pixel = camera_.project(p_camera);
    if (!pixel) continue;
    m.by_calibration.col(0) = (other.unproject(*pixel) - camera_.unproject(*pixel)) / kRadialStep;
    const double row = (pixel->y() + 0.5) / camera_.height - 0.5;
    if (moved[m.camera]) m.by_calibration.col(1) = byReadout(row, p_camera, *moved[m.camera]);
  }
}

void CalibrationAlignment::follow(const visual_frontend::CalibrationEstimate& estimate) {
  camera_ = visual_frontend::withRadial(camera_, estimate.error[0]);
  readout_time_ += estimate.error[1];
  mean_ -= estimate.error;
}

void CalibrationAlignment::recalibrate(const FrameTrajectory& frames, double readout_time, Map* map) const {
  visual_frontend::RollingShutter shutter(camera_, readout_time);
  for (const auto& entry : map->keyframes()) {
    Keyframe& keyframe = map->keyframe(entry.first);
    const auto moved = frames.velocityAt(keyframe.stamp, *map);
    shutter.setMotion(moved ? moved->angular : Eigen::Vector3d::Zero().eval(),
                      moved ? moved->linear : Eigen::Vector3d::Zero().eval());
    for (auto& o : keyframe.observations)
      o.normalized =
          shutter.toMiddleRow(o.pixel, camera_.unproject(o.pixel), inverseDepth(inCamera(*map, keyframe, o.landmark)));
    for (std::size_t i = 0; i < keyframe.orb_pixels.size(); ++i)
      keyframe.orb_normalized[i] = camera_.unproject(keyframe.orb_pixels[i]);
  }
}

}  // namespace mav_vo
