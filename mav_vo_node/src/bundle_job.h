// A bundle adjustment taken out of the map as plain data, so that it can run beside the tracking, and put back
// afterwards.
#pragma once

#include <map>
#include <vector>

#include "mav_vo/inertial_bundle.h"
#include "visual_frontend/map.h"

namespace mav_vo {

/// Velocities, biases and inertial motion of the map's keyframes.
struct InertialMap {
  std::map<visual_frontend::KeyframeId, InertialState> states;
  std::map<visual_frontend::KeyframeId, Preintegration> links;  ///< by keyframe: motion from the one before it
};

struct BundleJob {
  bool full = false;  ///< moves the whole map
  InertialBundleProblem problem;
  InertialBundleSettings settings;

  std::vector<visual_frontend::KeyframeId> keyframes;                          ///< one a camera
  std::vector<visual_frontend::LandmarkId> landmarks;                          ///< one a point
  std::vector<visual_frontend::LandmarkObservation> sources;                   ///< one a measurement
  visual_frontend::KeyframeId newest_keyframe = visual_frontend::kNoKeyframe;  ///< of the map at the time
  visual_frontend::LandmarkId newest_landmark = visual_frontend::kNoLandmark;  ///< of the map at the time

  bool usable = false;
  double seconds = 0;
  double rms = 0;  ///< in sigmas
  std::vector<int> outliers;

  void solve();
};

/// `free` keyframes move, `fixed` ones hold the landmarks that both see. Without a fixed one the oldest free keyframe
/// keeps its position and heading, and its whole pose where nothing tells which way is up. `metric`: the links'
/// velocities and positions count.
BundleJob makeBundleJob(const visual_frontend::Map& map, const InertialMap& inertial_map,
                        const std::vector<visual_frontend::KeyframeId>& free,
                        const std::vector<visual_frontend::KeyframeId>& fixed,
                        const visual_frontend::CameraModel& camera, double pixel_sigma, bool metric,
                        const air_ground_common::Pose& T_camera_imu);

/// Puts the result into the map. Keyframes and landmarks that came since are carried along with the newest keyframe of
/// the job.
void applyBundleJob(const BundleJob& job, visual_frontend::Map& map, InertialMap& inertial_map);

}  // namespace mav_vo
