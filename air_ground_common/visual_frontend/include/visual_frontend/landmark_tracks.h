// What the tracks of the feature tracker show: landmarks, or, of points not placed yet, the keyframes that saw them.
#pragma once

#include <unordered_map>
#include <vector>

#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/map.h"

namespace visual_frontend {

class LandmarkTracks {
 public:
  using Views = std::vector<LandmarkObservation>;

  LandmarkId landmarkOf(TrackId track) const;                  ///< kNoLandmark: none
  LandmarkId landmarkIn(const Map& map, TrackId track) const;  ///< kNoLandmark, too, where it has left the map
  bool has(TrackId track) const { return landmark_.count(track) > 0; }
  int count() const { return static_cast<int>(landmark_.size()); }  ///< tracks with a landmark
  std::vector<LandmarkId> landmarks() const;
  void assign(TrackId track, LandmarkId landmark);
  void release(TrackId track) { landmark_.erase(track); }

  Views viewsOf(TrackId track) const;
  void setViews(TrackId track, Views views) { views_[track] = std::move(views); }
  void addView(TrackId track, const LandmarkObservation& view) { views_[track].push_back(view); }
  void addViews(const Keyframe& keyframe);  ///< of all its tracks without landmark
  void forgetViews(TrackId track) { views_.erase(track); }

  /// Forgets tracks that are not among the features.
  void keep(const std::vector<Feature>& features);
  void forgetMissing(const Map& map);  ///< landmarks that are no longer in the map
  void forgetKeyframe(KeyframeId keyframe);
  void replace(LandmarkId from, LandmarkId by);
  void clear();

 private:
  std::unordered_map<TrackId, LandmarkId> landmark_;
  std::unordered_map<TrackId, Views> views_;
};

}  // namespace visual_frontend
