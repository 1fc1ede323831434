#include "visual_frontend/map.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "air_ground_common/statistics.h"

namespace visual_frontend {

double changeOfView(const Pose& T_map_a, const Pose& T_map_b, double scene_distance, const ViewLimits& limits) {
  const double distance = (T_map_a.translation() - T_map_b.translation()).norm();
  const double angle = air_ground_common::rotationAngle(T_map_a.linear(), T_map_b.linear());
  return std::max(distance / (limits.distance * scene_distance), angle / limits.angle);
}

KeyframeId Map::addKeyframe(Keyframe keyframe) {
  const KeyframeId id = next_keyframe_++;
  keyframe.id = id;
  keyframe.T_map_camera = air_ground_common::normalized(keyframe.T_map_camera);
  for (std::size_t i = 0; i < keyframe.observations.size(); ++i) {
    const LandmarkId landmark = keyframe.observations[i].landmark;
    if (landmark != kNoLandmark) landmarks_.at(landmark).observations.push_back({id, static_cast<int>(i)});
  }
  keyframes_.emplace(id, std::move(keyframe));
  return id;
}

LandmarkId Map::addLandmark(const Eigen::Vector3d& position) {
  const LandmarkId id = next_landmark_++;
  Landmark& landmark = landmarks_[id];
  landmark.id = id;
  landmark.position = position;
  return id;
}

bool Map::connect(KeyframeId keyframe, int index, LandmarkId landmark_id) {
  Observation& observation = keyframes_.at(keyframe).observations.at(index);
  Landmark& landmark = landmarks_.at(landmark_id);
  if (observation.landmark != kNoLandmark) return false;
  for (const LandmarkObservation& o : landmark.observations) {
    if (o.keyframe == keyframe) return false;
  }
  observation.landmark = landmark_id;
  landmark.observations.push_back({keyframe, index});
  return true;
}

void Map::disconnect(KeyframeId keyframe, int index) {
  Observation& observation = keyframes_.at(keyframe).observations.at(index);
  if (observation.landmark == kNoLandmark) return;
  Landmark& landmark = landmarks_.at(observation.landmark);
  observation.landmark = kNoLandmark;
  auto& list = landmark.observations;
  list.erase(std::remove_if(list.begin(), list.end(),
                            [&](const LandmarkObservation& o) { return o.keyframe == keyframe && o.index == index; }),
             list.end());
  if (list.empty()) landmarks_.erase(landmark.id);
}

void Map::removeLandmark(LandmarkId id) {
  const auto it = landmarks_.find(id);
  if (it == landmarks_.end()) return;
  for (const LandmarkObservation& o : it->second.observations) {
    keyframes_.at(o.keyframe).observations[o.index].landmark = kNoLandmark;
  }
  landmarks_.erase(it);
}

void Map::removeKeyframe(KeyframeId id) {
  const auto it = keyframes_.find(id);
  if (it == keyframes_.end()) return;
  for (std::size_t i = 0; i < it->second.observations.size(); ++i) disconnect(id, static_cast<int>(i));
  keyframes_.erase(it);
}

void Map::fuse(LandmarkId into, LandmarkId from) {
  if (into == from) return;
  landmarks_.at(into);  // throws before anything changed
  const std::vector<LandmarkObservation> moved = landmarks_.at(from).observations;
  removeLandmark(from);
  for (const LandmarkObservation& o : moved) connect(o.keyframe, o.index, into);
}

std::vector<LandmarkId> Map::landmarkIds() const {
  std::vector<LandmarkId> ids;
  ids.reserve(landmarks_.size());
  for (const auto& [id, landmark] : landmarks_) ids.push_back(id);
  std::sort(ids.begin(), ids.end());
  return ids;
}

KeyframeId Map::lastKeyframe() const { return keyframes_.empty() ? kNoKeyframe : keyframes_.rbegin()->first; }

std::vector<Map::Covisible> Map::observers(const std::vector<LandmarkId>& landmarks, int min_shared) const {
  std::map<KeyframeId, int> shared;
  for (const LandmarkId id : landmarks) {
    const auto it = landmarks_.find(id);
    if (it == landmarks_.end()) continue;
    for (const LandmarkObservation& o : it->second.observations) ++shared[o.keyframe];
  }
  std::vector<Covisible> result;
  for (const auto& [keyframe, count] : shared) {
    if (count >= min_shared) result.push_back({keyframe, count});
  }
  std::stable_sort(result.begin(), result.end(),
                   [](const Covisible& a, const Covisible& b) { return a.shared > b.shared; });
  return result;
}

std::vector<Map::Covisible> Map::covisible(KeyframeId id, int min_shared) const {
  std::vector<LandmarkId> seen;
  for (const Observation& o : keyframes_.at(id).observations) {
    if (o.landmark != kNoLandmark) seen.push_back(o.landmark);
  }
  std::vector<Covisible> result = observers(seen, min_shared);
  result.erase(std::remove_if(result.begin(), result.end(), [id](const Covisible& c) { return c.keyframe == id; }),
               result.end());
  return result;
}

std::vector<LandmarkId> Map::landmarksOf(const std::vector<KeyframeId>& keyframes) const {
  std::vector<LandmarkId> ids;
  for (const KeyframeId id : keyframes) {
    for (const Observation& o : keyframes_.at(id).observations) {
      if (o.landmark != kNoLandmark) ids.push_back(o.landmark);
    }
  }
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  return ids;
}

std::vector<KeyframeId> Map::nearestKeyframes(const Pose& T_map_camera, int count, double metres_per_radian) const {
  std::vector<std::pair<double, KeyframeId>> ranked;
  for (const auto& [id, keyframe] : keyframes_) {
    const double distance = (keyframe.T_map_camera.translation() - T_map_camera.translation()).norm();
    const double cosine = keyframe.T_map_camera.linear().col(2).dot(T_map_camera.linear().col(2));
    ranked.emplace_back(distance + metres_per_radian * std::acos(std::clamp(cosine, -1.0, 1.0)), id);
  }
  const std::size_t n = std::min<std::size_t>(std::max(0, count), ranked.size());
  std::partial_sort(ranked.begin(), ranked.begin() + n, ranked.end());
  std::vector<KeyframeId> result;
  for (std::size_t i = 0; i < n; ++i) result.push_back(ranked[i].second);
  return result;
}

void Map::dropFarImages(const Pose& T_map_camera, int keep, double metres_per_radian) {
  int with_image = 0;
  for (const auto& entry : keyframes_) with_image += !entry.second.pyramid.empty();
  if (with_image <= keep) return;
  const std::vector<KeyframeId> ranked =
      nearestKeyframes(T_map_camera, static_cast<int>(keyframes_.size()), metres_per_radian);
  for (auto id = ranked.rbegin(); id != ranked.rend() && with_image > keep; ++id) {
    Keyframe& k = keyframes_.at(*id);
    if (k.pyramid.empty()) continue;
    k.pyramid.clear();
    --with_image;
  }
}

std::optional<double> Map::medianDepth(const Keyframe& keyframe) const {
  const Pose T_camera_map = keyframe.T_map_camera.inverse();
  std::vector<double> depths;
  for (const Observation& o : keyframe.observations)
    if (o.landmark != kNoLandmark) depths.push_back((T_camera_map * landmarks_.at(o.landmark).position).z());
  if (depths.empty()) return std::nullopt;
  return air_ground_common::median(std::move(depths));
}

KeyframeId Map::redundantKeyframe(int newest, const ViewLimits& limits) const {
  if (keyframes_.size() <= static_cast<std::size_t>(std::max(0, newest))) return kNoKeyframe;
  const auto candidate = std::prev(keyframes_.end(), newest + 1);
  const Keyframe& later = candidate->second;
  const auto depth = medianDepth(later);
  if (!depth) return kNoKeyframe;
  for (auto it = keyframes_.begin(); it != candidate; ++it) {
    if (changeOfView(it->second.T_map_camera, later.T_map_camera, *depth, limits) >= 1) continue;
    const bool earlier_goes = it != keyframes_.begin() && it->second.pyramid.empty() && !later.pyramid.empty();
    return earlier_goes ? it->first : candidate->first;
  }
  return kNoKeyframe;
}

void Map::transform(const air_ground_common::Similarity& S) {
  for (auto& [id, keyframe] : keyframes_) {
    keyframe.T_map_camera.translation() = S * keyframe.T_map_camera.translation();
    keyframe.T_map_camera.linear() = S.R * keyframe.T_map_camera.linear();
    if (S.scale != 1.0) {
      for (Observation& o : keyframe.observations) {
        o.depth *= S.scale;
        o.depth_sigma *= S.scale;
      }
      for (double& depth : keyframe.orb_depth) depth *= S.scale;
    }
  }
  for (auto& [id, landmark] : landmarks_) {
    landmark.position = S * landmark.position;
    landmark.covariance = S.scale * S.scale * S.R * landmark.covariance * S.R.transpose();
  }
}

void Map::clear() {
  keyframes_.clear();
  landmarks_.clear();
}

}  // namespace visual_frontend
