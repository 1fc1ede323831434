// Finds landmarks of the local map again in the current image by their patches, so that loops in a small scene close
// without drift.
#pragma once

#include <vector>

#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/map.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct ReobservationSettings {
  double search_radius = 8.0;               ///< around the predicted pixel [px]
  int half_patch = 5;                       ///< patches have (2 h)^2 pixels
  double min_zncc = 0.85;                   ///< zero-mean normalised cross correlation of the aligned patch
  double max_view_angle = 0.7;              ///< between the ray now and in the reference keyframe [rad]
  double min_scale = 0.4, max_scale = 2.5;  ///< of the patch against its reference
  int max_matches = 150;                    ///< stops there
  int cell_size = 24;                       ///< at most one match a cell, landmarks with many observations first [px]
  int max_iterations = 12;                  ///< of the sub-pixel alignment
};

struct LandmarkMatch {
  LandmarkId landmark = kNoLandmark;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< distorted [px]
  Eigen::Vector2d normalized = Eigen::Vector2d::Zero();
  double zncc = 0;
};

/// Projects `candidates` into the current image with the predicted pose, warps each landmark's patch from the
/// observation whose viewing direction is nearest (plane facing that camera), searches by ZNCC at half resolution and
/// aligns with sub-pixel accuracy (inverse compositional, with gain and offset). `occupied`: pixels whose cells are
/// skipped (living tracks).
std::vector<LandmarkMatch> reobserve(const Map& map, const CameraModel& camera, const ImagePyramid& current,
                                     const Pose& T_map_camera_predicted, const std::vector<LandmarkId>& candidates,
                                     const std::vector<Eigen::Vector2d>& occupied,
                                     const ReobservationSettings& settings);

}  // namespace visual_frontend
