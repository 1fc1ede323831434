#include "frame_records.h"

#include <utility>

namespace mav_vo {

using air_ground_common::Pose;
using visual_frontend::KeyframeId;
using visual_frontend::Map;

namespace {

constexpr std::size_t kRecentImages = 800;  // whose inertial motion is kept for the scale filter
constexpr std::size_t kMaxRecords = 40000;  // half an hour at 20 Hz; older images are thinned

}  // namespace

void FrameRecords::add(FrameRecord record) {
  records_.push_back(std::move(record));
  if (records_.size() > kRecentImages) records_[records_.size() - 1 - kRecentImages].motion.reset();
  if (records_.size() <= kMaxRecords) return;
  std::size_t kept = 0;
  const std::size_t half = records_.size() / 2;
  for (std::size_t i = 0; i < records_.size(); ++i)
    if (i >= half || i % 2 == 0) records_[kept++] = std::move(records_[i]);
  records_.resize(kept);
}

Pose FrameRecords::pose(std::size_t i, const Map& map) const {
  return map.keyframe(records_[i].reference).T_map_camera * records_[i].T_reference_camera;
}

air_ground_common::Trajectory FrameRecords::poses(const Map& map) const {
  air_ground_common::Trajectory trajectory;
  for (std::size_t i = 0; i < records_.size(); ++i) trajectory.push_back({records_[i].stamp, pose(i, map)});
  return trajectory;
}

void FrameRecords::lastIsKeyframe(KeyframeId id) {
  records_.back().reference = id;
  records_.back().T_reference_camera.setIdentity();
}

void FrameRecords::rebase(KeyframeId from, KeyframeId to, const Pose& T_to_from) {
  for (FrameRecord& record : records_) {
    if (record.reference != from) continue;
    record.reference = to;
    record.T_reference_camera = T_to_from * record.T_reference_camera;
  }
}

void FrameRecords::transform(const air_ground_common::Similarity& S) {
  for (FrameRecord& record : records_) {
    record.T_reference_camera.translation() *= S.scale;
    record.scene_distance *= S.scale;
    record.position_covariance = (S.scale * S.scale * S.R * record.position_covariance * S.R.transpose()).eval();
  }
}

}  // namespace mav_vo
