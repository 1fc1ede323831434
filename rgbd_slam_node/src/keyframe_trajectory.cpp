#include "keyframe_trajectory.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>

namespace rgbd_slam {

using air_ground_common::Pose;
using visual_frontend::KeyframeId;
using visual_frontend::Map;

namespace {

constexpr double kLongestStep = 0.25;  // between frames that tell of one motion [s]

}  // namespace

void KeyframeTrajectory::Frame::set(const Pose& T_reference_camera) {
  const Eigen::Vector3d t = T_reference_camera.translation();
  const Eigen::Vector4d q = Eigen::Quaterniond(T_reference_camera.linear()).coeffs();
  std::copy(t.data(), t.data() + 3, translation);
  std::copy(q.data(), q.data() + 4, rotation);
}

Pose KeyframeTrajectory::Frame::pose() const {
  Pose T = Pose::Identity();
  T.translation() = Eigen::Map<const Eigen::Vector3f>(translation).cast<double>();
  const Eigen::Vector4d q = Eigen::Map<const Eigen::Vector4f>(rotation).cast<double>();
  T.linear() = Eigen::Quaterniond(q).normalized().toRotationMatrix();
  return T;
}

void KeyframeTrajectory::add(double stamp, const Pose& T_map_camera, KeyframeId reference, const Map& map) {
  T_reference_last_ = map.keyframe(reference).T_map_camera.inverse() * T_map_camera;
  frames_.push_back({stamp, reference, {}, {}});
  frames_.back().set(T_reference_last_);
}

Pose KeyframeTrajectory::lastPose(const Map& map) const {
  return map.keyframe(frames_.back().reference).T_map_camera * T_reference_last_;
}

std::optional<visual_frontend::CameraVelocity> KeyframeTrajectory::velocityAt(double stamp, const Map& map) const {
  const auto at = std::lower_bound(frames_.begin(), frames_.end(), stamp,
                                   [](const Frame& f, double earlier) { return f.stamp < earlier; });
  if (at == frames_.end() || at->stamp != stamp) return std::nullopt;
  const auto usable = [&](const auto& f) { return std::abs(f->stamp - stamp) < kLongestStep; };
  const auto before = at != frames_.begin() && usable(std::prev(at)) ? std::prev(at) : at;
  const auto after = std::next(at) != frames_.end() && usable(std::next(at)) ? std::next(at) : at;
  const double dt = after->stamp - before->stamp;
  if (!(dt > 0)) return std::nullopt;
  const auto poseOf = [&map](const auto& f) { return Pose(map.keyframe(f->reference).T_map_camera * f->pose()); };
  return visual_frontend::velocityBetween(poseOf(before), poseOf(at), poseOf(after), dt);
}

air_ground_common::Trajectory KeyframeTrajectory::poses(const Map& map) const {
  air_ground_common::Trajectory result;
  result.reserve(frames_.size());
  for (const Frame& f : frames_) result.push_back({f.stamp, map.keyframe(f.reference).T_map_camera * f.pose()});
  return result;
}

void KeyframeTrajectory::rebase(KeyframeId from, KeyframeId to, const Map& map) {
  const Pose T_to_from = map.keyframe(to).T_map_camera.inverse() * map.keyframe(from).T_map_camera;
  if (!frames_.empty() && frames_.back().reference == from) T_reference_last_ = T_to_from * T_reference_last_;
  for (Frame& f : frames_) {
    if (f.reference != from) continue;
    f.reference = to;
    f.set(T_to_from * f.pose());
  }
}

}  // namespace rgbd_slam
