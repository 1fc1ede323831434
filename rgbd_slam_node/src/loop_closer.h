// Places seen before: ORB descriptors, geometric check, pose graph, merging of landmarks.
#pragma once

#include <map>
#include <optional>
#include <set>

#include "rgbd_slam/slam.h"
#include "visual_frontend/landmark_tracks.h"

namespace rgbd_slam {

class LoopCloser {
 public:
  enum class Outcome {
    kNone,
    kRefused,   ///< the correction would be larger than what the way driven explains
    kMerged,    ///< the place's landmarks were joined with the keyframe's; poses were right as they were
    kCorrected  ///< and the poses along the loop were moved
  };

  LoopCloser(const CameraModel& camera, const SlamSettings& settings) : camera_(camera), settings_(settings) {}

  void setCamera(const CameraModel& camera) { camera_ = camera; }  ///< the same, better known
  void clear();
  void advance(double way) { path_ += way; }         ///< the camera has moved by so much [m]
  void add(KeyframeId id) { path_at_[id] = path_; }  ///< a new keyframe, where the camera is
  void forget(KeyframeId id) { path_at_.erase(id); }
  /// Looks for the place of keyframe `id` among earlier ones. `level`: gravity is known, roll and pitch stay.
  Outcome close(KeyframeId id, bool level, visual_frontend::Map& map, visual_frontend::LandmarkTracks& tracks) const;

 private:
  /// `near`: keyframes that share landmarks with `id`.
  std::vector<KeyframeId> placesInReach(KeyframeId id, const std::set<KeyframeId>& near,
                                        const visual_frontend::Map& map) const;
  /// Along which the pose of `id` may have drifted against that of `place` [m].
  double wayBetween(KeyframeId place, KeyframeId id, const std::set<KeyframeId>& near) const;
  void mergeLandmarks(KeyframeId id, const std::vector<std::pair<int, LandmarkId>>& seen, visual_frontend::Map& map,
                      visual_frontend::LandmarkTracks& tracks) const;

  CameraModel camera_;
  SlamSettings settings_;
  double path_ = 0;                       // way driven in this map [m]
  std::map<KeyframeId, double> path_at_;  // until each keyframe [m]
};

}  // namespace rgbd_slam
