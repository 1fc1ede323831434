#include "visual_frontend/keyframe_trajectory.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>

namespace visual_frontend {

namespace {

constexpr double kLongestStep = 0.25;  // between frames that tell of one motion [s]

}  // namespace

CompactPose::CompactPose(const Pose& T) {
  const Eigen::Vector3d t = T.translation();
  const Eigen::Vector4d q = Eigen::Quaterniond(T.linear()).coeffs();
  std::copy(t.data(), t.data() + 3, translation_);
  std::copy(q.data(), q.data() + 4, rotation_);
}

CompactPose::operator Pose() const {
  Pose T = Pose::Identity();
  T.translation() = Eigen::Map<const Eigen::Vector3f>(translation_).cast<double>();
  const Eigen::Vector4d q = Eigen::Map<const Eigen::Vector4f>(rotation_).cast<double>();
  T.linear() = Eigen::Quaterniond(q).normalized().toRotationMatrix();
  return T;
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::add(double stamp, const Pose& T_map_camera, KeyframeId reference, const Map& map) {
  const Keyframe& keyframe = map.keyframe(reference);
  if (frames_.empty() || reference != lastReference()) {
    if (!frames_.empty() && keyframe.stamp == stamp)
      link(reference, map.keyframe(lastReference()).T_map_camera.inverse() * keyframe.T_map_camera);
    run_begin_ = stamp;
    T_reference_run_.setIdentity();
  }
  T_reference_last_ = keyframe.T_map_camera.inverse() * T_map_camera;
  frames_.push_back({stamp, reference, Pose(T_reference_run_.inverse() * T_reference_last_)});
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::lastIsKeyframe(KeyframeId id) {
  if (id != lastReference()) {
    link(id, T_reference_last_);
    T_reference_last_.setIdentity();
  }
  T_reference_run_ = T_reference_last_;
  run_begin_ = lastStamp();
  frames_.back().reference = id;
  frames_.back().T_reference_camera = Pose(Pose::Identity());
}

/// The last reference's frames of this run lead to keyframe `next`, made of the newest image.
template <class StoredPose>
void KeyframeTrajectory<StoredPose>::link(KeyframeId next, const Pose& T_reference_next) {
  // Where one has a link already, the camera has come back to it: frames of then lead elsewhere.
  links_.emplace(lastReference(), Link{next, run_begin_, lastStamp(), T_reference_run_.inverse() * T_reference_next});
}

/// Null: the frame goes by its reference alone.
template <class StoredPose>
const typename KeyframeTrajectory<StoredPose>::Link* KeyframeTrajectory<StoredPose>::linkOf(const Frame& frame) const {
  const auto found = links_.find(frame.reference);
  if (found == links_.end()) return nullptr;
  return frame.stamp > found->second.begin && frame.stamp <= found->second.end ? &found->second : nullptr;
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::clear() {
  frames_.clear();
  links_.clear();
}

template <class StoredPose>
bool KeyframeTrajectory<StoredPose>::isKeyframe(std::size_t i) const {
  return Pose(frames_[i].T_reference_camera).matrix().isIdentity(1e-12);
}

template <class StoredPose>
Pose KeyframeTrajectory<StoredPose>::pose(std::size_t i, const Map& map) const {
  const Frame& frame = frames_[i];
  const Pose T_reference_camera = frame.T_reference_camera;
  const Pose T = map.keyframe(frame.reference).T_map_camera * T_reference_camera;
  const Link* const link = linkOf(frame);
  if (!link) return T;
  const Keyframe& next = map.keyframe(link->next);
  const Pose by_next = next.T_map_camera * link->T_this_next.inverse() * T_reference_camera;
  const double share = (frame.stamp - link->begin) / (next.stamp - link->begin);
  return air_ground_common::interpolate(T, by_next, share);
}

template <class StoredPose>
air_ground_common::Trajectory KeyframeTrajectory<StoredPose>::poses(const Map& map) const {
  air_ground_common::Trajectory result;
  result.reserve(frames_.size());
  for (std::size_t i = 0; i < frames_.size(); ++i) result.push_back({frames_[i].stamp, pose(i, map)});
  return result;
}

template <class StoredPose>
std::optional<CameraVelocity> KeyframeTrajectory<StoredPose>::velocityAt(double stamp, const Map& map) const {
  const auto found = std::lower_bound(frames_.begin(), frames_.end(), stamp,
                                      [](const Frame& f, double earlier) { return f.stamp < earlier; });
  if (found == frames_.end() || found->stamp != stamp) return std::nullopt;
  const std::size_t at = found - frames_.begin();
  const auto usable = [&](std::size_t i) { return std::abs(frames_[i].stamp - stamp) < kLongestStep; };
  const std::size_t before = at > 0 && usable(at - 1) ? at - 1 : at;
  const std::size_t after = at + 1 < frames_.size() && usable(at + 1) ? at + 1 : at;
  const double dt = frames_[after].stamp - frames_[before].stamp;
  if (!(dt > 0)) return std::nullopt;
  return velocityBetween(pose(before, map), pose(at, map), pose(after, map), dt);
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::rebase(KeyframeId from, KeyframeId to, const Map& map) {
  const Pose T_to_from = map.keyframe(to).T_map_camera.inverse() * map.keyframe(from).T_map_camera;
  if (!frames_.empty() && lastReference() == from) {
    T_reference_last_ = T_to_from * T_reference_last_;
    T_reference_run_.setIdentity();
  }
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    Frame& frame = frames_[i];
    const Link* const link = linkOf(frame);
    if (frame.reference != from && !(link && link->next == from)) continue;
    const Pose T_map_camera = pose(i, map);
    if (frame.reference == from) frame.reference = to;
    frame.T_reference_camera = Pose(map.keyframe(frame.reference).T_map_camera.inverse() * T_map_camera);
  }
  links_.erase(from);
  for (auto it = links_.begin(); it != links_.end();) it = it->second.next == from ? links_.erase(it) : std::next(it);
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::rescale(double scale) {
  T_reference_last_.translation() *= scale;
  T_reference_run_.translation() *= scale;
  for (auto& [id, link] : links_) link.T_this_next.translation() *= scale;
  for (Frame& f : frames_) {
    Pose T = f.T_reference_camera;
    T.translation() *= scale;
    f.T_reference_camera = T;
  }
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::thin(std::size_t most) {
  if (frames_.size() <= most) return;
  std::size_t kept = 0;
  const std::size_t half = frames_.size() / 2;
  for (std::size_t i = 0; i < frames_.size(); ++i)
    if (i >= half || i % 2 == 0) frames_[kept++] = frames_[i];
  frames_.erase(frames_.begin() + static_cast<std::ptrdiff_t>(kept), frames_.end());
}

template class KeyframeTrajectory<Pose>;
template class KeyframeTrajectory<CompactPose>;

}  // namespace visual_frontend
