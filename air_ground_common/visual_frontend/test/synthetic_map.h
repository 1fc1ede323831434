// Keyframes of maps with exact truth, for the tests of the front end and of what is built on it.
#pragma once

#include <vector>

#include "visual_frontend/map.h"

namespace visual_frontend::synthetic {

/// With an observation of each landmark, wherever that is in the image.
inline Keyframe keyframeSeeing(const std::vector<LandmarkId>& landmarks) {
  Keyframe keyframe;
  for (const LandmarkId id : landmarks) keyframe.observations.push_back({id});
  return keyframe;
}

/// With those of the landmarks that lie in the camera's image, where they are.
inline Keyframe keyframeAt(const Pose& T_map_camera, const Map& map, const std::vector<LandmarkId>& landmarks,
                           const CameraModel& camera) {
  Keyframe keyframe;
  keyframe.T_map_camera = T_map_camera;
  for (const LandmarkId id : landmarks) {
    const auto pixel = camera.project(T_map_camera.inverse() * map.landmark(id).position);
    if (!pixel || !camera.contains(*pixel)) continue;
    Observation o;
    o.landmark = id;
    o.pixel = *pixel;
    o.normalized = camera.unproject(*pixel);
    keyframe.observations.push_back(o);
  }
  return keyframe;
}

}  // namespace visual_frontend::synthetic
