#include "visual_frontend/landmark_tracks.h"

#include <algorithm>

namespace visual_frontend {

LandmarkId LandmarkTracks::landmarkOf(TrackId track) const {
  const auto it = landmark_.find(track);
  return it == landmark_.end() ? kNoLandmark : it->second;
}

LandmarkId LandmarkTracks::landmarkIn(const Map& map, TrackId track) const {
  const LandmarkId landmark = landmarkOf(track);
  return map.hasLandmark(landmark) ? landmark : kNoLandmark;
}

std::vector<LandmarkId> LandmarkTracks::landmarks() const {
  std::vector<LandmarkId> ids;
  for (const auto& entry : landmark_) ids.push_back(entry.second);
  return ids;
}

void LandmarkTracks::assign(TrackId track, LandmarkId landmark) {
  landmark_[track] = landmark;
  views_.erase(track);
}

LandmarkTracks::Views LandmarkTracks::viewsOf(TrackId track) const {
  const auto it = views_.find(track);
  return it == views_.end() ? Views() : it->second;
}

void LandmarkTracks::addViews(const Keyframe& keyframe) {
  for (std::size_t i = 0; i < keyframe.observations.size(); ++i)
    if (keyframe.observations[i].landmark == kNoLandmark)
      addView(keyframe.observations[i].track, {keyframe.id, static_cast<int>(i)});
}

void LandmarkTracks::keep(const std::vector<Feature>& features) {
  LandmarkTracks kept;
  for (const Feature& f : features) {
    if (const auto it = landmark_.find(f.id); it != landmark_.end()) kept.landmark_.insert(*it);
    if (const auto it = views_.find(f.id); it != views_.end()) kept.views_.insert(*it);
  }
  *this = std::move(kept);
}

void LandmarkTracks::forgetMissing(const Map& map) {
  for (auto it = landmark_.begin(); it != landmark_.end();)
    it = map.hasLandmark(it->second) ? std::next(it) : landmark_.erase(it);
}

void LandmarkTracks::forgetKeyframe(KeyframeId keyframe) {
  for (auto& [track, views] : views_) {
    views.erase(std::remove_if(views.begin(), views.end(),
                               [&](const LandmarkObservation& v) { return v.keyframe == keyframe; }),
                views.end());
  }
}

void LandmarkTracks::replace(LandmarkId from, LandmarkId by) {
  for (auto& entry : landmark_) {
    if (entry.second == from) entry.second = by;
  }
}

void LandmarkTracks::clear() {
  landmark_.clear();
  views_.clear();
}

}  // namespace visual_frontend
