// Landmarks of the keyframes around the camera: made of the tracks that a keyframe ends, and looked for by those that
// come back.
#pragma once

#include <vector>

#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/map.h"
#include "visual_frontend/triangulation.h"

namespace visual_frontend {

/// A track of a keyframe that gave no landmark.
struct UnplacedTrack {
  TrackId track;
  int observation;  ///< of the keyframe
  TriangulationStatus status;
};

/// Makes landmarks of those tracks of keyframe `id` that have none, from all their views (LandmarkTracks::addViews), as
/// far as `settings` allow. `pixel_sigma`: of a feature [px]. Returns the others. Throws std::out_of_range for a
/// keyframe that is not in the map.
std::vector<UnplacedTrack> createLandmarks(KeyframeId id, const CameraModel& camera, double pixel_sigma,
                                           const TriangulationSettings& settings, Map& map, LandmarkTracks& tracks);

/// Landmarks that the `count` keyframes nearest to a pose see, and none of the features tracks; ascending.
std::vector<LandmarkId> untrackedLandmarks(const Map& map, const LandmarkTracks& tracks,
                                           const std::vector<Feature>& features, const Pose& T_map_camera, int count,
                                           double metres_per_radian = 1.0);

}  // namespace visual_frontend
