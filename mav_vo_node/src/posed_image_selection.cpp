#include "posed_image_selection.h"

#include <cmath>

#include "air_ground_common/geometry.h"

namespace mav_vo {
namespace {

constexpr std::size_t kMostStamps = 40000;
constexpr double kAngle = 0.05;           // [rad], as DenseMapper's
constexpr double kLongest = 0.199;        // [s]: the rows of a rolling shutter take their motion from neighbours
constexpr double kNominalDistance = 2.0;  // [m], as dense_fusion's nominal_distance

}  // namespace

bool PosedImageSelection::selects(const VoResult& frame) {
  double unit = 1;  // [m] of the map's
  if (!frame.metric && frame.depth_min > 0 && frame.depth_max >= frame.depth_min)
    unit = kNominalDistance / std::sqrt(frame.depth_min * frame.depth_max);
  const bool same_map = frame.map_id == map_id_ && frame.map_revision == map_revision_;
  const double moved = unit * (frame.T_map_camera.translation() - T_map_camera_.translation()).norm();
  const double gap = frame.stamp - stamp_;
  if (same_map && !frame.keyframe && gap >= 0 && gap < kLongest && moved < spacing_ &&
      air_ground_common::rotationAngle(frame.T_map_camera.linear(), T_map_camera_.linear()) < kAngle)
    return false;
  if (map_id_ != frame.map_id) stamps_.clear();
  stamps_.insert(frame.stamp);
  if (stamps_.size() > kMostStamps) stamps_.erase(stamps_.begin());
  map_id_ = frame.map_id;
  map_revision_ = frame.map_revision;
  stamp_ = frame.stamp;
  T_map_camera_ = frame.T_map_camera;
  return true;
}

air_ground_common::Trajectory PosedImageSelection::selected(const air_ground_common::Trajectory& trajectory) const {
  air_ground_common::Trajectory poses;
  for (const auto& pose : trajectory)
    if (stamps_.count(pose.stamp) > 0) poses.push_back(pose);
  return poses;
}

}  // namespace mav_vo
