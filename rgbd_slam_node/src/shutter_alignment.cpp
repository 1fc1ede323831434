#include "shutter_alignment.h"

#include <algorithm>
#include <cmath>

namespace rgbd_slam {

namespace {

constexpr double kReadoutSigma = 4e-3;    // of a readout time that is taken into use [s]
constexpr double kReadoutStep = 5e-3;     // least change of one that nobody has told [s]
constexpr double kRefinedSigma = 2e-3;    // of one that replaces one in use [s]
constexpr double kRefinement = 2e-3;      // least change of it [s]
constexpr double kLongestReadout = 0.08;  // [s]

/// What was seen at a pixel, with its depth or, without, about as far as `inverse_depth`, where the middle row sees it.
void moveToMiddleRow(const visual_frontend::RollingShutter& shift, const Eigen::Vector2d& pixel, double inverse_depth,
                     Eigen::Vector2d* normalized, double* depth) {
  if (*depth > 0) {
    const Eigen::Vector3d p = shift.pointToMiddleRow(pixel.y(), *depth * normalized->homogeneous());
    *normalized = p.hnormalized();
    *depth = p.z();
  } else {
    *normalized = shift.toMiddleRow(pixel, *normalized, inverse_depth);
  }
}

}  // namespace

ShutterAlignment::ShutterAlignment(const CameraModel& camera, const SlamSettings& settings)
    : depth_(settings.depth), height_(camera.height) {
  if (settings.readout_time_stddev > 0)
    estimator_.emplace(settings.readout_time, settings.readout_time_stddev,
                       settings.pixel_sigma / (0.5 * (camera.fx + camera.fy)));
}

void ShutterAlignment::interrupt() {
  if (estimator_) estimator_->interrupt();
}

void ShutterAlignment::reset() {
  if (estimator_) estimator_->reset();
}

std::optional<double> ShutterAlignment::add(const RgbdImages& images, const Pose& T_map_camera,
                                            const std::vector<visual_frontend::Feature>& features, double in_use) {
  if (!estimator_) return std::nullopt;
  std::vector<RowPoint> points;
  for (const visual_frontend::Feature& f : features) {
    const auto z = sampleDepth(images.depth, f.pixel, depth_);
    if (!z) continue;
    points.push_back({f.id, *z * f.normalized.homogeneous(), depth_.sigma(*z), (f.pixel.y() + 0.5) / height_ - 0.5});
  }
  if (!estimator_->add(images.stamp, T_map_camera, points)) return std::nullopt;
  const double readout = estimator_->readoutTime(), sigma = estimator_->stddev();
  const bool used = in_use != 0;
  const double enough = used ? std::max(kRefinement, 2 * sigma) : std::max(kReadoutStep, 3 * sigma);
  if (sigma > (used ? kRefinedSigma : kReadoutSigma) || std::abs(readout) > kLongestReadout ||
      std::abs(readout - in_use) < enough)
    return std::nullopt;
  if (!used) estimator_->distrust();
  return readout;
}

void moveRows(double change, const CameraModel& camera, const Frames& frames, visual_frontend::Map& map,
              DenseKeyframes& dense, KeyframeSurfaces& surfaces) {
  dense.finish();
  visual_frontend::RollingShutter shift(camera, change);
  for (const auto& entry : map.keyframes()) {
    visual_frontend::Keyframe& keyframe = map.keyframe(entry.first);
    const auto moved = frames.velocityAt(keyframe.stamp, map);
    if (!moved) continue;
    shift.setMotion(moved->angular, moved->linear);
    const Pose T_camera_map = keyframe.T_map_camera.inverse();
    for (visual_frontend::Observation& o : keyframe.observations) {
      const double z = map.hasLandmark(o.landmark) ? (T_camera_map * map.landmark(o.landmark).position).z() : 0;
      moveToMiddleRow(shift, o.pixel, z > 0.1 ? 1 / z : 0, &o.normalized, &o.depth);
    }
    for (std::size_t i = 0; i < keyframe.orb_pixels.size(); ++i)
      moveToMiddleRow(shift, keyframe.orb_pixels[i], 0, &keyframe.orb_normalized[i], &keyframe.orb_depth[i]);
    dense.moveRows(keyframe.id, shift);
    surfaces.moveRows(keyframe.id, shift);
  }
  surfaces.relink(map);
}

}  // namespace rgbd_slam
