#include "visual_frontend/calibration_alignment.h"

#include <vector>

namespace visual_frontend {

namespace {

constexpr double kHeld = 1e-9;        // standard deviation of what is not estimated
constexpr double kRadialStep = 1e-4;  // of the numeric derivative

/// A landmark in a keyframe's camera; behind it where it is not known.
Eigen::Vector3d inCamera(const Map& map, const Keyframe& keyframe, LandmarkId landmark) {
  if (landmark == kNoLandmark || !map.hasLandmark(landmark)) return -Eigen::Vector3d::UnitZ();
  return keyframe.T_map_camera.inverse() * map.landmark(landmark).position;
}

/// Where a point lies in the middle row's view, by the readout time [1/s].
Eigen::Vector2d byReadout(double row, const Eigen::Vector3d& p_camera, const CameraVelocity& moved) {
  const Eigen::Vector3d ray = p_camera / p_camera.z();
  const Eigen::Vector3d shift = row * (moved.angular.cross(ray) + moved.linear / p_camera.z());
  return shift.head<2>() - ray.head<2>() * shift.z();
}

}  // namespace

CalibrationAlignment::CalibrationAlignment(const CameraModel& camera, double readout_time, double radial_stddev,
                                           double readout_time_stddev)
    : camera_(camera),
      camera_before_(camera),
      estimates_(radial_stddev > 0 || readout_time_stddev > 0),
      readout_time_(readout_time) {
  sigma_ << radial_stddev, readout_time_stddev;
  sigma_ = sigma_.cwiseMax(kHeld).eval();
  mean_.setZero();
}

void CalibrationAlignment::open(const VelocityAt& velocity, const Map& map, BundleJob* job) const {
  job->problem.calibration.emplace();
  job->problem.calibration->mean = mean_;
  job->problem.calibration->sigma = sigma_;
  const CameraModel other = withRadial(camera_, kRadialStep);
  std::vector<std::optional<CameraVelocity>> moved;
  for (const auto id : job->keyframes) moved.push_back(velocity(map.keyframe(id).stamp));
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

void CalibrationAlignment::follow(const CalibrationEstimate& estimate) {
  camera_before_ = camera_;
  camera_ = withRadial(camera_, estimate.error[0]);
  readout_change_ = estimate.error[1];
  readout_time_ += readout_change_;
  mean_ -= estimate.error;
}

void CalibrationAlignment::followReadout(double readout_time) {
  camera_before_ = camera_;
  readout_change_ = readout_time - readout_time_;
  readout_time_ = readout_time;
}

void CalibrationAlignment::recalibrate(const VelocityAt& velocity, Map* map) const {
  // A pixel that one of the two does not see keeps its ray: no adjustment takes one that is no number.
  const auto moved = [this](const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized) {
    const Eigen::Vector2d now = normalized + camera_.unproject(pixel) - camera_before_.unproject(pixel);
    return now.allFinite() ? now : normalized;
  };
  RollingShutter shift(camera_, readout_change_);
  for (const auto& entry : map->keyframes()) {
    Keyframe& keyframe = map->keyframe(entry.first);
    const auto motion = velocity(keyframe.stamp);
    if (motion) shift.setMotion(motion->angular, motion->linear);
    for (Observation& o : keyframe.observations) {
      const double z = inCamera(*map, keyframe, o.landmark).z();
      o.normalized = moved(o.pixel, o.normalized);
      if (motion) o.normalized = shift.toMiddleRow(o.pixel, o.normalized, z > 0 ? 1 / z : 0);
    }
    for (std::size_t i = 0; i < keyframe.orb_pixels.size(); ++i)
      keyframe.orb_normalized[i] = moved(keyframe.orb_pixels[i], keyframe.orb_normalized[i]);
  }
}

}  // namespace visual_frontend
