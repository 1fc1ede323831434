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
  T_reference_last_ = map.keyframe(reference).T_map_camera.inverse() * T_map_camera;
  frames_.push_back({stamp, reference, T_reference_last_});
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::lastIsKeyframe(KeyframeId id) {
  T_reference_last_.setIdentity();
  frames_.back().reference = id;
  frames_.back().T_reference_camera = T_reference_last_;
}

template <class StoredPose>
bool KeyframeTrajectory<StoredPose>::isKeyframe(std::size_t i) const {
  return Pose(frames_[i].T_reference_camera).matrix().isIdentity(1e-12);
}

template <class StoredPose>
Pose KeyframeTrajectory<StoredPose>::pose(std::size_t i, const Map& map) const {
  return map.keyframe(frames_[i].reference).T_map_camera * Pose(frames_[i].T_reference_camera);
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
  if (!frames_.empty() && lastReference() == from) T_reference_last_ = T_to_from * T_reference_last_;
  for (Frame& f : frames_) {
    if (f.reference != from) continue;
    f.reference = to;
    f.T_reference_camera = Pose(T_to_from * Pose(f.T_reference_camera));
  }
}

template <class StoredPose>
void KeyframeTrajectory<StoredPose>::rescale(double scale) {
  T_reference_last_.translation() *= scale;
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
