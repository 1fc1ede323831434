// Tracks that are followed from image to image drift, a little with each. They are put back to where the first view of
// their point is in the current image.
#pragma once

#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/map.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct RealignmentSettings {
  int half_patch = 7;                        ///< patches have (2 h)^2 pixels
  double min_zncc = 0.85;                    ///< zero-mean normalised cross correlation of the aligned patch
  double max_view_angle = 0.5;               ///< between the ray now and in the reference keyframe [rad]
  double min_scale = 0.65, max_scale = 1.5;  ///< of the patch against its reference
  double max_shift = 1.5;                    ///< from where the track is; what lies further away is something else [px]
  int max_iterations = 12;                   ///< of the sub-pixel alignment
};

/// Moves the tracker's features to where the oldest like view of their point in the map's keyframes is aligned in the
/// current image: its patch, warped as the camera's pose has it (plane facing the keyframe), with gain and offset.
/// Features of points not placed yet are taken to be `distance` away. Others stay where they are: those that no
/// keyframe with images has seen from about there, and those whose patch has changed. Returns how many were aligned.
int realignTracks(const Map& map, const LandmarkTracks& tracks, const Pose& T_map_camera, double distance,
                  const RealignmentSettings& settings, FeatureTracker* tracker);

}  // namespace visual_frontend
