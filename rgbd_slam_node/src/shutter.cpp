// Rolling shutter: its readout time is found from the frames, and what the map was made of is put right.
#include <algorithm>
#include <cmath>

#include "slam_impl.h"

namespace rgbd_slam {

namespace {

constexpr double kReadoutSigma = 4e-3;    // of a readout time that is taken into use [s]
constexpr double kReadoutStep = 5e-3;     // least change of one that nobody has told [s]
constexpr double kRefinedSigma = 2e-3;    // of one that replaces one in use [s]
constexpr double kRefinement = 2e-3;      // least change of it [s]
constexpr double kLongestReadout = 0.08;  // [s]

}  // namespace

bool Slam::Impl::alignShutter(const Images& images) {
  if (!shutter) return false;
  std::vector<RowPoint> points;
  for (const Feature& f : tracker.features()) {
    const auto z = sampleDepth(images.depth, f.pixel, settings.depth);
    if (!z) continue;
    points.push_back(
        {f.id, *z * f.normalized.homogeneous(), settings.depth.sigma(*z), (f.pixel.y() + 0.5) / camera.height - 0.5});
  }
  if (!shutter->add(images.stamp, lastPose(), points)) return false;
  const double readout = shutter->readoutTime(), sigma = shutter->stddev();
  const double change = readout - motion.rows().readoutTime();
  const bool in_use = motion.rows().active();
  const double enough = in_use ? std::max(kRefinement, 2 * sigma) : std::max(kReadoutStep, 3 * sigma);
  if (sigma > (in_use ? kRefinedSigma : kReadoutSigma) || std::abs(readout) > kLongestReadout ||
      std::abs(change) < enough)
    return false;
  const Pose T_map_before = lastPose();
  moveRows(change);
  motion.setReadoutTime(readout);
  if (!in_use) shutter->distrust();
  if (map.keyframeCount() > 1) adjustWhole();
  motion.moveMap(lastPose() * T_map_before.inverse());
  return true;
}

void Slam::Impl::moveRows(double change) {
  finishDepth();
  visual_frontend::RollingShutter shift(camera, change);
  for (const auto& entry : map.keyframes()) {
    Keyframe& keyframe = map.keyframe(entry.first);
    const auto moved = frames.velocityAt(keyframe.stamp, map);
    if (!moved) continue;
    shift.setMotion(moved->angular, moved->linear);
    const Pose T_camera_map = keyframe.T_map_camera.inverse();
    const auto put = [&shift](const Eigen::Vector2d& pixel, double inverse_depth, Eigen::Vector2d* normalized,
                              double* depth) {
      if (*depth > 0) {
        const Eigen::Vector3d p = shift.pointToMiddleRow(pixel.y(), *depth * normalized->homogeneous());
        *normalized = p.hnormalized();
        *depth = p.z();
      } else {
        *normalized = shift.toMiddleRow(pixel, *normalized, inverse_depth);
      }
    };
    for (Observation& o : keyframe.observations) {
      const double z = map.hasLandmark(o.landmark) ? (T_camera_map * map.landmark(o.landmark).position).z() : 0;
      put(o.pixel, z > 0.1 ? 1 / z : 0, &o.normalized, &o.depth);
    }
    for (std::size_t i = 0; i < keyframe.orb_pixels.size(); ++i)
      put(keyframe.orb_pixels[i], 0, &keyframe.orb_normalized[i], &keyframe.orb_depth[i]);
    const auto dense = keyframe_points.find(keyframe.id);
    if (dense == keyframe_points.end()) continue;
    auto points = std::make_shared<std::vector<KeyframeDepth::Point>>(*dense->second);
    for (KeyframeDepth::Point& point : *points) {
      const Eigen::Vector3d p = point.position.cast<double>();
      if (const auto pixel = camera.project(p)) point.position = shift.pointToMiddleRow(pixel->y(), p).cast<float>();
    }
    dense->second = std::move(points);
  }
}

}  // namespace rgbd_slam
