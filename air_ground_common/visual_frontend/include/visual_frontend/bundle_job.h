// A part of a map as a bundle problem: taken out as plain data, so that it can be solved beside what goes on with the
// map, and put back afterwards.
#pragma once

#include <map>
#include <vector>

#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/map.h"

namespace visual_frontend {

/// Velocities, biases and inertial motion of a map's keyframes.
struct InertialMap {
  std::map<KeyframeId, InertialState> states;
  std::map<KeyframeId, Preintegration> links;  ///< by keyframe: motion from the one before it
  Pose T_camera_imu = Pose::Identity();
  bool metric = false;  ///< the map's unit is the metre: velocities and positions of the links count
};

/// Where a keyframe stands to another, by something else than landmarks.
struct KeyframeLink {
  KeyframeId a = kNoKeyframe, b = kNoKeyframe;
  Pose T_a_b = Pose::Identity();
  Matrix6d information = Matrix6d::Zero();  ///< of d in T_a_b * exp(d); may be singular
};

struct BundleJob {
  bool full = false;             ///< moves the whole map
  bool for_calibration = false;  ///< of use only where it finds the camera to be another one
  BundleProblem problem;
  BundleSettings settings;
  BundleResult result;

  std::vector<KeyframeId> keyframes;         ///< one a camera
  std::vector<LandmarkId> landmarks;         ///< one a point
  std::vector<LandmarkObservation> sources;  ///< one a measurement
  KeyframeId newest_keyframe = kNoKeyframe;  ///< of the map at the time
  LandmarkId newest_landmark = kNoLandmark;  ///< of the map at the time

  /// An estimated calibration stays in the problem where the images are sure that it is another one; else poses and
  /// points are those of the camera as it was, or the result is not usable where it was for the calibration.
  void solve();
};

/// `free` keyframes and the landmarks they see move, `fixed` ones hold those landmarks; keyframes in neither list are
/// not used. At least one should be fixed (two for a monocular map without gravity), else the first free one is held:
/// whole, or with `inertial` only its position and heading where something tells which way is up. Throws
/// std::out_of_range for keyframes that are not in the map.
BundleJob extractBundle(const Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                        const std::vector<KeyframeId>& fixed, const BundleSettings& settings,
                        const InertialMap* inertial = nullptr);

/// The same with `links`, of which those between keyframes of the job count.
BundleJob extractBundle(const Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                        const std::vector<KeyframeId>& fixed, const BundleSettings& settings,
                        const std::vector<KeyframeLink>& links);
/// The same of all keyframes; the oldest is held.
BundleJob extractWholeMap(const Map& map, const CameraModel& camera, const BundleSettings& settings,
                          const std::vector<KeyframeLink>& links);

/// Puts a usable result into the map. Keyframes and landmarks that came since are carried along with the newest
/// keyframe of the job. Disconnects outliers; landmarks left with one observation without depth are removed.
void applyBundle(const BundleJob& job, Map& map, InertialMap* inertial = nullptr);

}  // namespace visual_frontend
