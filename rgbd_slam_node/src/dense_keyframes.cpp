#include "dense_keyframes.h"

#include <utility>

#include "rgbd_slam/hidden_space.h"

namespace rgbd_slam {

using Points = std::vector<KeyframeDepth::Point>;

namespace {

constexpr double kRecentStep = 0.15;  // between frames that are remembered [s]
constexpr double kRecent = 0.9;       // for how long: who walks has gone on by his own width [s]

}  // namespace

void DenseKeyframes::clear() {
  points_.clear();
  rays_.clear();
  gone_.clear();
  recent_.clear();
  active_.reset();
}

void DenseKeyframes::remember(double stamp, const cv::Mat& depth, const Pose& T_map_camera,
                              const visual_frontend::RollingShutter& rows) {
  if (!recent_.empty() && stamp - recent_.back().stamp < kRecentStep) return;
  recent_.push_back({stamp, depth.clone(), T_map_camera, rows});
  while (stamp - recent_.front().stamp > kRecent) recent_.pop_front();
}

void DenseKeyframes::begin(KeyframeId id, double stamp, const cv::Mat& depth, const cv::Mat& colour,
                           const Pose& T_map_camera, const visual_frontend::RollingShutter& rows) {
  finish();
  active_ = std::make_unique<KeyframeDepth>(camera_, depth, colour, depth_, cloud_, &rows);
  active_id_ = id;
  for (const Recent& frame : recent_)
    if (stamp - frame.stamp <= kRecent)
      active_->fuse(camera_, frame.depth, frame.T_map_camera.inverse() * T_map_camera, depth_, cloud_, &frame.rows);
  frames_before_ = active_->frames();
  rays_[id] = std::make_shared<const DepthRays>(camera_, depth, depth_);
}

void DenseKeyframes::fuse(const cv::Mat& depth, const Pose& T_frame_keyframe,
                          const visual_frontend::RollingShutter& rows) {
  if (!active_) return;
  if (active_->frames() - frames_before_ >= max_frames_) return finish();
  active_->fuse(camera_, depth, T_frame_keyframe, depth_, cloud_, &rows);
}

bool DenseKeyframes::lookThrough(KeyframeId id, const cv::Mat& depth, const Pose& T_frame_keyframe,
                                 const visual_frontend::RollingShutter& rows) {
  const auto dense = points_.find(id);
  if (dense == points_.end()) return false;
  GonePoints& gone = gone_[id];
  gone.look(camera_, *dense->second, depth, T_frame_keyframe, depth_, cloud_, rows);
  KeyframePoints left = gone.left(*dense->second);
  if (!left) return false;
  dense->second = std::move(left);
  return true;
}

void DenseKeyframes::finish() {
  if (!active_) return;
  points_[active_id_] = std::make_shared<const Points>(active_->points(depth_, cloud_));
  active_.reset();
}

void DenseKeyframes::moveRows(KeyframeId id, const visual_frontend::RollingShutter& shift) {
  const auto dense = points_.find(id);
  if (dense == points_.end()) return;
  auto points = std::make_shared<Points>(*dense->second);
  for (KeyframeDepth::Point& point : *points) {
    const Eigen::Vector3d p = point.position.cast<double>();
    if (const auto pixel = camera_.project(p)) point.position = shift.pointToMiddleRow(pixel->y(), p).cast<float>();
  }
  dense->second = std::move(points);
}

void DenseKeyframes::recalibrate(const CameraModel& camera) {
  finish();
  // By whose pixel it was made; where that says nothing, as before.
  const auto recalibrated = [&](const Eigen::Vector3d& p) -> Eigen::Vector3f {
    const auto pixel = camera_.project(p);
    if (!pixel) return p.cast<float>();
    const Eigen::Vector2d ray = camera.unproject(*pixel);
    return (ray.allFinite() ? Eigen::Vector3d(p.z() * ray.homogeneous()) : p).cast<float>();
  };
  for (auto& entry : points_) {
    auto points = std::make_shared<Points>(*entry.second);
    for (KeyframeDepth::Point& point : *points) point.position = recalibrated(point.position.cast<double>());
    entry.second = std::move(points);
  }
  for (auto& entry : rays_) {
    auto rays = std::make_shared<DepthRays>(*entry.second);
    for (DepthRays::Ray& ray : rays->rays) {
      const Eigen::Vector3f now = recalibrated({ray.x, ray.y, 1});
      ray.x = now.x();
      ray.y = now.y();
    }
    entry.second = std::move(rays);
  }
  camera_ = camera;
}

std::shared_ptr<const DepthRays> DenseKeyframes::raysOf(KeyframeId id) const {
  const auto it = rays_.find(id);
  return it == rays_.end() ? nullptr : it->second;
}

std::vector<PosedPoints> DenseKeyframes::posed(const visual_frontend::Map& map) const {
  std::vector<PosedPoints> result;
  for (const auto& [id, points] : points_) result.push_back({map.keyframe(id).T_map_camera, points, id, raysOf(id)});
  if (active_)
    result.push_back({map.keyframe(active_id_).T_map_camera,
                      std::make_shared<const Points>(active_->points(depth_, cloud_)), active_id_, raysOf(active_id_)});
  return result;
}

}  // namespace rgbd_slam
