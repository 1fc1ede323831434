#include "visual_frontend/local_landmarks.h"

#include <algorithm>

namespace visual_frontend {

namespace {

std::vector<ViewRay> raysOf(const LandmarkTracks::Views& views, const CameraModel& camera, double pixel_sigma,
                            const Map& map) {
  std::vector<ViewRay> rays;
  for (const LandmarkObservation& view : views) {
    const Keyframe& keyframe = map.keyframe(view.keyframe);
    const Observation& seen = keyframe.observations[view.index];
    const NormalizedNoise noise = camera.normalizedNoise(seen.normalized, pixel_sigma);
    rays.push_back(
        {keyframe.T_map_camera, seen.normalized, noise.sigma, seen.depth, seen.depth_sigma, noise.elongation});
  }
  return rays;
}

}  // namespace

std::vector<UnplacedTrack> createLandmarks(KeyframeId id, const CameraModel& camera, double pixel_sigma,
                                           const TriangulationSettings& settings, Map& map, LandmarkTracks& tracks) {
  std::vector<UnplacedTrack> unplaced;
  const int count = static_cast<int>(map.keyframe(id).observations.size());
  for (int i = 0; i < count; ++i) {
    const Observation& o = map.keyframe(id).observations[i];
    if (o.landmark != kNoLandmark) continue;
    const LandmarkTracks::Views views = tracks.viewsOf(o.track);
    const TriangulationResult point = triangulate(raysOf(views, camera, pixel_sigma, map), settings);
    if (!point.ok()) {
      unplaced.push_back({o.track, i, point.status});
      continue;
    }
    const LandmarkId landmark = map.addLandmark(point.p_map);
    map.landmark(landmark).covariance = point.covariance;
    for (const LandmarkObservation& view : views) map.connect(view.keyframe, view.index, landmark);
    tracks.assign(o.track, landmark);
  }
  return unplaced;
}

std::vector<LandmarkId> untrackedLandmarks(const Map& map, const LandmarkTracks& tracks,
                                           const std::vector<Feature>& features, const Pose& T_map_camera, int count,
                                           double metres_per_radian) {
  std::vector<LandmarkId> tracked;
  for (const Feature& f : features) tracked.push_back(tracks.landmarkOf(f.id));
  std::sort(tracked.begin(), tracked.end());
  std::vector<LandmarkId> untracked;
  for (const LandmarkId id : map.landmarksOf(map.nearestKeyframes(T_map_camera, count, metres_per_radian)))
    if (!std::binary_search(tracked.begin(), tracked.end(), id)) untracked.push_back(id);
  return untracked;
}

}  // namespace visual_frontend
