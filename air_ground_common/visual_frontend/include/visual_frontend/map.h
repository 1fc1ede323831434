// Keyframes and landmarks, their observations, and who sees what together.
#pragma once

#include <map>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <unordered_map>
#include <vector>

#include "visual_frontend/types.h"

namespace visual_frontend {

/// One image measurement of a keyframe; it may not have a landmark (yet).
struct Observation {
  LandmarkId landmark = kNoLandmark;
  TrackId track = kNoTrack;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();       ///< distorted [px]
  Eigen::Vector2d normalized = Eigen::Vector2d::Zero();  ///< undistorted x/z, y/z
  double depth = 0;                                      ///< measured z in the camera frame [m]; 0 = none
  double depth_sigma = 0;                                ///< its standard deviation [m]
};

struct Keyframe {
  KeyframeId id = kNoKeyframe;
  double stamp = 0;  ///< [s]
  Pose T_map_camera = Pose::Identity();
  std::vector<Observation> observations;
  /// Greyscale pyramid of the image (level 0 first) for patch matching; may be empty.
  std::vector<cv::Mat> pyramid;
  /// Direction that is up (against gravity) in the camera frame, unit, and its standard deviation [rad]: a prior on
  /// roll and pitch in bundle adjustment.
  std::optional<Eigen::Vector3d> up_camera;
  double up_sigma = 0.02;

  // Place recognition: ORB features of the whole image (see place_recognition.h).
  std::vector<Eigen::Vector2d> orb_pixels;      ///< distorted [px]
  std::vector<Eigen::Vector2d> orb_normalized;  ///< undistorted
  std::vector<float> orb_angle;                 ///< [rad]
  std::vector<int> orb_octave;
  std::vector<double> orb_depth;  ///< measured z [m], 0 = none; empty without a depth camera
  cv::Mat orb_descriptors;        ///< n x 32 CV_8U
};

struct LandmarkObservation {
  KeyframeId keyframe = kNoKeyframe;
  int index = 0;  ///< into Keyframe::observations
};

struct Landmark {
  LandmarkId id = kNoLandmark;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< in the map [m]
  std::vector<LandmarkObservation> observations;       ///< the first is the reference: its patch is the landmark's look
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of position [m^2]; zero = not known
};

/// How far apart two cameras may be that see the same.
struct ViewLimits {
  double distance;  ///< over that of the scene: seen from afar, parallax grows slowly [1]
  double angle;     ///< [rad]
};

/// How far a view is from another, by the larger of distance and angle over what the limits allow.
double changeOfView(const Pose& T_map_a, const Pose& T_map_b, double scene_distance, const ViewLimits& limits);

/// Owns keyframes and landmarks; keeps both sides of each observation consistent. Not thread-safe.
class Map {
 public:
  /// Takes the keyframe with its observations (their landmark fields must name existing landmarks or none); sets its
  /// id. Its rotation is made one to the last digit: poses are products of those of keyframes before, whose errors
  /// would grow with each.
  KeyframeId addKeyframe(Keyframe keyframe);

  /// New landmark without observations.
  LandmarkId addLandmark(const Eigen::Vector3d& position);

  /// Ties observation `index` of a keyframe to a landmark. False (nothing changes) when the observation already has a
  /// landmark or the keyframe already sees that one. Throws std::out_of_range for unknown ids.
  bool connect(KeyframeId keyframe, int index, LandmarkId landmark);

  /// Unties it; a landmark left without observations is removed.
  void disconnect(KeyframeId keyframe, int index);

  void removeLandmark(LandmarkId id);
  void removeKeyframe(KeyframeId id);

  /// Moves the observations of `from` to `into`, where they do not collide, and removes `from`.
  void fuse(LandmarkId into, LandmarkId from);

  bool hasKeyframe(KeyframeId id) const { return keyframes_.count(id) > 0; }
  bool hasLandmark(LandmarkId id) const { return landmarks_.count(id) > 0; }
  Keyframe& keyframe(KeyframeId id) { return keyframes_.at(id); }  ///< throws std::out_of_range
  const Keyframe& keyframe(KeyframeId id) const { return keyframes_.at(id); }
  Landmark& landmark(LandmarkId id) { return landmarks_.at(id); }
  const Landmark& landmark(LandmarkId id) const { return landmarks_.at(id); }
  const std::map<KeyframeId, Keyframe>& keyframes() const { return keyframes_; }  ///< in order of time
  const std::unordered_map<LandmarkId, Landmark>& landmarks() const { return landmarks_; }
  std::vector<LandmarkId> landmarkIds() const;  ///< ascending, so that runs are deterministic
  std::size_t keyframeCount() const { return keyframes_.size(); }
  std::size_t landmarkCount() const { return landmarks_.size(); }
  KeyframeId lastKeyframe() const;                                  ///< kNoKeyframe when empty
  LandmarkId newestLandmark() const { return next_landmark_ - 1; }  ///< that was ever added; kNoLandmark: none was

  struct Covisible {
    KeyframeId keyframe;
    int shared;  ///< landmarks seen by both
  };
  /// Keyframes that share at least `min_shared` landmarks with `id`, most first.
  std::vector<Covisible> covisible(KeyframeId id, int min_shared = 1) const;
  /// Keyframes that see at least `min_shared` of the given landmarks, most first.
  std::vector<Covisible> observers(const std::vector<LandmarkId>& landmarks, int min_shared = 1) const;

  /// Median depth of the landmarks that a keyframe sees; none: it sees none [m].
  std::optional<double> medianDepth(const Keyframe& keyframe) const;

  /// Landmarks seen from any of the keyframes, each once, ascending.
  std::vector<LandmarkId> landmarksOf(const std::vector<KeyframeId>& keyframes) const;

  /// Keyframes nearest to a pose by distance plus `metres_per_radian` times the angle between the optical axes.
  std::vector<KeyframeId> nearestKeyframes(const Pose& T_map_camera, int count, double metres_per_radian = 1.0) const;

  /// Bounds the memory: of the keyframes with an image pyramid only the `keep` nearest to a pose keep it. The others
  /// stay in the map and can be recognised by their ORB features, but no patch is taken from them.
  void dropFarImages(const Pose& T_map_camera, int keep, double metres_per_radian = 1.0);

  /// Bounds the memory where the same places are seen again and again. Of the keyframes older than the newest `newest`
  /// the youngest may go: when an earlier one has the same view, within `limits` and by its scene's median depth, the
  /// one of the two without an image, else the later, is the answer. kNoKeyframe: none. The first keyframe stays.
  KeyframeId redundantKeyframe(int newest, const ViewLimits& limits) const;

  /// Applies p' = S * p to all landmarks and moves the cameras with it (camera poses stay rigid). For scale and
  /// leveling.
  void transform(const air_ground_common::Similarity& S_new_old);

  void clear();

 private:
  std::map<KeyframeId, Keyframe> keyframes_;
  std::unordered_map<LandmarkId, Landmark> landmarks_;
  KeyframeId next_keyframe_ = 0;
  LandmarkId next_landmark_ = 0;
};

}  // namespace visual_frontend
