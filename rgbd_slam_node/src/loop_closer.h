// Places seen before: ORB descriptors, geometric check, pose graph, merging of landmarks.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <vector>

#include "rgbd_slam/slam.h"
#include "visual_frontend/keyframe_covariances.h"
#include "visual_frontend/landmark_tracks.h"

namespace rgbd_slam {

class LoopCloser {
 public:
  enum class Outcome {
    kNone,
    kRefused,   ///< the way driven explains no such correction, too little speaks for it, or another place looks alike
    kMerged,    ///< the place's landmarks were joined with the keyframe's; poses were right as far as that can tell
    kCorrected  ///< and the poses along the loop were moved
  };

  LoopCloser(const CameraModel& camera, const SlamSettings& settings) : camera_(camera), settings_(settings) {}

  void setCamera(const CameraModel& camera) { camera_ = camera; }  ///< the same, better known
  void clear();
  void moveTo(const Eigen::Vector3d& p_map);        ///< the camera is there [m]
  void add(KeyframeId id) { ways_[id] = {path_}; }  ///< a new keyframe, where the camera is
  /// Keyframe `from` leaves the map for `by`, which stands in its place: the camera has been there by both ways.
  void replace(KeyframeId from, KeyframeId by);
  /// Looks for the place of keyframe `id` among earlier ones. `level`: gravity is known, roll and pitch stay.
  /// `covariances`: of the keyframes, as their chain of views tells.
  Outcome close(KeyframeId id, bool level, const visual_frontend::KeyframeCovariances& covariances,
                visual_frontend::Map& map, visual_frontend::LandmarkTracks& tracks) const;

 private:
  /// What a recognised place would do to the keyframe.
  struct Correction {
    double shift, turn;  ///< [m], [rad]
    bool explained;      ///< by the way driven
    bool expected;       ///< by the covariances of keyframe, place and match; true where these are not known
    bool noise;          ///< the match alone may err by as much
  };
  Correction correctionBy(const visual_frontend::PlaceMatch& match, KeyframeId id, const std::set<KeyframeId>& near,
                          const visual_frontend::KeyframeCovariances& covariances,
                          const visual_frontend::Map& map) const;
  /// `near`: keyframes that share landmarks with `id`.
  std::vector<KeyframeId> placesInReach(KeyframeId id, const std::set<KeyframeId>& near,
                                        const visual_frontend::Map& map) const;
  /// Along which the pose of `id` may have drifted against that of `place` [m].
  double wayBetween(KeyframeId place, KeyframeId id, const std::set<KeyframeId>& near) const;
  void mergeLandmarks(KeyframeId id, const std::vector<std::pair<int, LandmarkId>>& seen, visual_frontend::Map& map,
                      visual_frontend::LandmarkTracks& tracks) const;

  CameraModel camera_;
  SlamSettings settings_;
  double path_ = 0;                                 // way driven in this map [m]
  std::optional<Eigen::Vector3d> anchor_;           // in the map, where the way was counted last [m]
  std::map<KeyframeId, std::vector<double>> ways_;  // each time a keyframe's place was reached, ascending [m]
};

}  // namespace rgbd_slam
