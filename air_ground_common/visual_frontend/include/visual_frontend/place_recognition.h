// Place recognition with ORB: for loop closure and to relocalise after tracking is lost.
#pragma once

#include <algorithm>
#include <limits>
#include <optional>
#include <vector>

#include "visual_frontend/map.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct PlaceSettings {
  int orb_features = 500;
  int orb_levels = 5;
  int max_hamming = 60;      ///< of 256 bits
  double max_ratio = 0.85;   ///< best over second-best distance
  int min_matches = 25;      ///< mutual matches for a candidate
  int max_candidates = 4;    ///< that are verified geometrically
  int min_inliers = 20;      ///< of the pose
  double pixel_sigma = 1.5;  ///< of ORB positions at level 0 [px]
};

/// ORB features of an image (CV_8UC1) into keyframe.orb_*; depth is left empty. Throws std::invalid_argument otherwise.
void describeKeyframe(const cv::Mat& gray, const CameraModel& camera, const PlaceSettings& settings,
                      Keyframe& keyframe);

/// Mutual nearest descriptors with ratio test: pairs (index in a, index in b).
std::vector<std::pair<int, int>> matchDescriptors(const cv::Mat& a, const cv::Mat& b, const PlaceSettings& settings);

struct PlaceMatch {
  bool success = false;
  std::string reason;
  bool ambiguous = false;                  ///< no success, since another place looks alike
  KeyframeId keyframe = kNoKeyframe;       ///< the place
  Pose T_place_query = Pose::Identity();   ///< camera of the query in the camera frame of the place
  Matrix6d covariance = Matrix6d::Zero();  ///< of T_place_query, in the place's camera frame
  int matches = 0;
  int inliers = 0;
  /// Landmarks recognised: index of the query's ORB feature, landmark of the map.
  std::vector<std::pair<int, LandmarkId>> landmarks;
};

/// Searches `places` (in the map) for the best place of `query` by descriptor matches, then verifies by 3D-2D pose
/// RANSAC and refinement. 3D points: the place's ORB features with measured depth, otherwise those within 3 px of an
/// observed landmark; failing both, the query's own depth measurements (inverse direction).
PlaceMatch recognizePlace(const Map& map, const CameraModel& camera, const Keyframe& query,
                          const std::vector<KeyframeId>& places, const PlaceSettings& settings);

/// Of `places`, what puts the camera elsewhere than `best` does, by more than a fifth of the way to what it sees or
/// 0.2 rad, while `best` has less than `min_lead` times as many inliers. Places beside `best` are not asked.
std::vector<PlaceMatch> rivalsOf(const PlaceMatch& best, const Map& map, const CameraModel& camera,
                                 const Keyframe& query, const std::vector<KeyframeId>& places, double min_lead,
                                 const PlaceSettings& settings);

/// What a jump back into the map must look like after tracking was lost.
struct RelocalizationGate {
  Pose T_map_last = Pose::Identity();                             ///< camera when it was last known
  double max_distance = std::numeric_limits<double>::infinity();  ///< that it can have moved since [map unit]
  std::optional<Eigen::Vector3d>
      up_camera;           ///< against gravity, camera frame now, unit; the map's z axis is up. None: not known
  double max_tilt = 0.15;  ///< between that and the map's up as the place has it [rad]
  /// Orientation now, as a gyro has carried it on since the camera was last known. None: not known.
  std::optional<Eigen::Matrix3d> R_map_camera;
  double max_turn = 0.15;          ///< between that and the place's [rad]
  double min_lead = 1.4;           ///< inliers of the place over those of the best place that puts the camera elsewhere
  std::vector<KeyframeId> places;  ///< among which it is sought; empty: the whole map

  /// R_map_camera, known to `sigma` [rad] after the camera was lost for so long [s]. It is worth less with time: a gyro
  /// saturates where a vehicle is hit, and feels nothing while a recording begins again.
  void setTurn(const Eigen::Matrix3d& R, double sigma, double lost_for) {
    R_map_camera = R;
    max_turn = std::max(max_turn, 3 * sigma) + 0.5 * lost_for;
  }
};

/// recognizePlace for a camera that was lost: places that the gate excludes do not count, and of two
/// that look alike none is taken. `reason` says what stood against it.
PlaceMatch relocalize(const Map& map, const CameraModel& camera, const Keyframe& query, const RelocalizationGate& gate,
                      const PlaceSettings& settings);

}  // namespace visual_frontend
