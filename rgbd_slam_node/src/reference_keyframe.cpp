#include "reference_keyframe.h"

#include <algorithm>

namespace rgbd_slam {

using visual_frontend::Keyframe;
using visual_frontend::Map;

namespace {

constexpr double kSameView = 0.25;     // of the change of view that makes a keyframe
constexpr double kNearView = 0.75;     // likewise
constexpr double kUnknownDepth = 2.0;  // of a scene without landmarks [m]
constexpr int kLongLasting = 4;        // of its patience: the view no longer changes as it did
constexpr int kDrivingPast = 2;        // keyframes that are outgrown at one place by a camera that drives past it
constexpr int kMostOutgrown = 13;      // that count: minutes of patience

int landmarksOf(const Keyframe& keyframe) {
  return static_cast<int>(
      std::count_if(keyframe.observations.begin(), keyframe.observations.end(),
                    [](const visual_frontend::Observation& o) { return o.landmark != visual_frontend::kNoLandmark; }));
}

}  // namespace

double ReferenceKeyframe::changeOfView(const Map& map, const Keyframe& keyframe, const Pose& T_map_camera) const {
  return visual_frontend::changeOfView(T_map_camera, keyframe.T_map_camera,
                                       map.medianDepth(keyframe).value_or(kUnknownDepth),
                                       {settings_.keyframe_translation, settings_.keyframe_rotation});
}

bool ReferenceKeyframe::outgrown(const Keyframe& keyframe, double change, int landmarks) const {
  if (change > 1) return true;
  // From where the keyframe stood, another sees nothing new, unless landmarks were lost since.
  const int seen = landmarksOf(keyframe);
  return (change > kSameView || seen > 1.25 * landmarks) &&
         (landmarks < settings_.keyframe_overlap * seen || landmarks < 3 * settings_.min_inliers);
}

// What moves before a camera that stands hides other landmarks each moment, and may push the pose to and fro: no
// keyframe lasts.
void ReferenceKeyframe::set(const Map& map, KeyframeId id) {
  const bool moved_on = !map.hasKeyframe(id) || changeOfView(map, map.keyframe(id), T_map_place_) > 1;
  if (moved_on || id_ == visual_frontend::kNoKeyframe) {
    outgrown_here_ = 0;
    if (map.hasKeyframe(id)) T_map_place_ = map.keyframe(id).T_map_camera;
  } else if (frames_ < kLongLasting * patience()) {
    outgrown_here_ = std::min(outgrown_here_ + 1, kMostOutgrown);
  } else {
    outgrown_here_ = std::max(outgrown_here_ - 1, 0);
  }
  id_ = id;
  frames_ = 0;
}

int ReferenceKeyframe::patience() const {
  return settings_.keyframe_min_gap << std::max(outgrown_here_ - kDrivingPast, 0);
}

bool ReferenceKeyframe::due(const Map& map, const Pose& T_map_camera, int landmarks) const {
  if (frames_ < settings_.keyframe_min_gap) return false;
  const Keyframe& keyframe = map.keyframe(id_);
  const double change = changeOfView(map, keyframe, T_map_camera);
  return change > 1 || (frames_ >= patience() && outgrown(keyframe, change, landmarks));
}

KeyframeId ReferenceKeyframe::ofView(const Map& map, const visual_frontend::LandmarkTracks& tracks,
                                     const Pose& T_map_camera, int landmarks) const {
  // Shared landmarks say that the two are right to each other: else there may be a loop to close.
  for (const auto& c : map.observers(tracks.landmarks(), 2 * settings_.min_inliers)) {
    const Keyframe& keyframe = map.keyframe(c.keyframe);
    if (!outgrown(keyframe, changeOfView(map, keyframe, T_map_camera), landmarks)) return c.keyframe;
  }
  return visual_frontend::kNoKeyframe;
}

KeyframeId ReferenceKeyframe::nearest(const Map& map, const Pose& T_map_camera) const {
  if (changeOfView(map, map.keyframe(id_), T_map_camera) <= 1) return id_;
  KeyframeId best = visual_frontend::kNoKeyframe;
  double least = kNearView;
  for (const auto& [id, keyframe] : map.keyframes()) {
    const double change = changeOfView(map, keyframe, T_map_camera);
    if (change > least) continue;
    least = change;
    best = id;
  }
  return best;
}

bool ReferenceKeyframe::hasFewLandmarks(const Map& map) const {
  return landmarksOf(map.keyframe(id_)) < settings_.min_start_features;
}

bool ReferenceKeyframe::same(const Map& map, KeyframeId earlier, KeyframeId later) const {
  return changeOfView(map, map.keyframe(earlier), map.keyframe(later).T_map_camera) <= kSameView;
}

}  // namespace rgbd_slam
