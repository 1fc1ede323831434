// State of Slam, shared by the files that implement it: slam.cpp (frames in, results out), tracking.cpp (pose of a
// frame), mapping.cpp (keyframes, landmarks, local optimisation), loops.cpp (places seen before), leveling.cpp and
// shutter.cpp (rows of the images).
#pragma once

#include <set>
#include <utility>

#include "camera_motion.h"
#include "rgbd_slam/readout_estimator.h"
#include "rgbd_slam/rotation_check.h"
#include "rgbd_slam/slam.h"
#include "visual_frontend/keyframe_covariances.h"
#include "visual_frontend/keyframe_trajectory.h"
#include "visual_frontend/landmark_tracks.h"

namespace rgbd_slam {

using visual_frontend::Feature;
using visual_frontend::Keyframe;
using visual_frontend::kNoKeyframe;
using visual_frontend::kNoLandmark;
using visual_frontend::kNoTrack;
using visual_frontend::Landmark;
using visual_frontend::LandmarkMatch;
using visual_frontend::LandmarkObservation;
using visual_frontend::LandmarkTracks;
using visual_frontend::Observation;
using visual_frontend::PoseCorrespondence;
using visual_frontend::PoseResult;

struct Slam::Impl {
  Impl(const CameraModel& camera_model, const Mounting& mounted, const SlamSettings& slam_settings);

  /// What the camera saw at a time.
  struct Images {
    double stamp;
    const cv::Mat &gray, &colour, &depth;
  };

  // ---- Fixed
  CameraModel camera;
  Mounting mounting;
  SlamSettings settings;
  double focal;  ///< [px]
  Pose T_camera_base;

  // ---- Sensors
  visual_frontend::FeatureTracker tracker;
  CameraMotion motion;
  RotationCheck turns;                      ///< gyro against images
  std::optional<ReadoutEstimator> shutter;  ///< none: the readout time is given

  // ---- Map
  visual_frontend::Map map;
  LandmarkTracks tracks;
  visual_frontend::KeyframeCovariances covariances;
  std::map<KeyframeId, double> keyframe_path;  ///< way driven until there [m]
  std::map<KeyframeId, KeyframePoints> keyframe_points;
  std::unique_ptr<KeyframeDepth> active_depth;  ///< of the last keyframe, while that is the reference
  KeyframeId reference = kNoKeyframe;           ///< whose view the present frames share
  bool gravity_known = false;
  bool leveled = false;      ///< or nothing to level with
  double tilt_sigma = 0.05;  ///< of the map against gravity, about its origin, what it is known to lean included [rad]
  Vertical vertical;
  int map_id = 0;
  SlamCounters counters;

  // ---- Trajectory
  visual_frontend::KeyframeTrajectory<visual_frontend::CompactPose> frames;
  State state = State::kWaiting;
  double first_stamp = -1;
  double last_stamp = -1;
  double strange_for = 0;     ///< lost, the camera has seen other places than those of the map for so long [s]
  double since_attempt = 0;   ///< to relocalise [s]
  double last_attempt = -1;   ///< at finding the way back [s]
  std::string lost_reason;    ///< what came of it
  bool nearly_found = false;  ///< some of a place's points agreed, too few to be sure: the next image is worth a look
  double path = 0;
  int since_keyframe = 0;
  int since_reobservation = 0;

  struct Tracked {
    bool success = false;
    std::string reason;
    PoseResult pose;
    int landmarks = 0;
  };

  // ---- slam.cpp
  FrameResult process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth);
  void check(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth) const;
  FrameResult initialize(const Images& images);
  void beLost();
  /// Takes the step from the last frame to this one; returns what the base moved by.
  Pose step(double stamp, const Pose& T_map_camera, bool relocalized);
  /// Compares the turn from the last frame to this one with the gyro's, and goes on without a gyro that contradicts.
  void compareTurns(double stamp, const Pose& T_map_camera);
  /// Keeps the frame, in the view of a keyframe there is or as a new one.
  void addToMap(const Images& images, const Tracked& tracked, FrameResult* result);
  void concludePose(const Matrix6d& camera_covariance, const Matrix6d& frame_covariance, FrameResult* result) const;
  void clear();
  Pose lastPose() const { return frames.lastPose(map); }

  // ---- leveling.cpp
  /// Up in a camera and its standard deviation [rad], to hold a keyframe by.
  std::optional<std::pair<Eigen::Vector3d, double>> upOfCamera(const Eigen::Matrix3d& R_map_camera) const;
  bool levelMap();  ///< when the map leans for certain; true when it turned the map

  // ---- shutter.cpp
  /// Learns the readout time from this frame, and takes it into use once it is sure; true when that moved the map.
  bool alignShutter(const Images& images);
  /// What the keyframes saw, as if their readout time were longer by `change` [s].
  void moveRows(double change);

  // ---- tracking.cpp
  Tracked track(const Images& images);
  Tracked relocalize(const Images& images);
  /// Follows the features into the image, those of landmarks from where they are expected.
  void trackFeatures(const Images& images, const Pose& T_map_predicted);
  /// Why a pose found from so many landmarks cannot be; empty: it can.
  std::string objection(double stamp, const PoseResult& pose, std::size_t landmarks) const;
  /// Searches the local map around a pose found by recognition or prediction; without success no track is left.
  Tracked accept(const Images& images, const Pose& around, double radius);
  visual_frontend::PlaceMatch recognize(const Images& images);
  Pose predict(double stamp, bool* from_gyro) const;
  /// What the camera sees at a pixel, as of the middle row: normalised coordinates, and depth where it is measured.
  /// `inverse_depth`: as far as known otherwise [1/m].
  Observation observe(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized, const cv::Mat& depth,
                      double inverse_depth = 0) const;
  PoseCorrespondence correspondence(LandmarkId landmark, const Eigen::Vector2d& pixel,
                                    const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                    const Pose& T_camera_map) const;
  PoseResult solve(const std::vector<PoseCorrespondence>& c, const Pose& predicted, bool rotation_known) const;
  /// Searches the local map around a pose, refines it with what was found, and starts tracks there.
  void reobserveLocalMap(const Pose& around, double radius, const cv::Mat& depth, PoseResult* pose);
  void startTracks(const std::vector<LandmarkMatch>& matches);

  // ---- mapping.cpp
  /// Whether a frame with so many landmarks sees other things than the keyframe, by more than the settings allow.
  bool outgrown(const Keyframe& keyframe, const Pose& T_map_camera, int landmarks) const;
  bool keyframeDue(const Pose& T_map_camera, int landmarks) const;
  /// An earlier keyframe whose view a frame has come back to; kNoKeyframe: none.
  KeyframeId keyframeOfView(const Pose& T_map_camera, int landmarks) const;
  void setReference(KeyframeId id);
  /// Takes keyframes out of the map that stood where `id` stands now, so that going about the same ground adds nothing.
  void removeReplacedBy(KeyframeId id);
  KeyframeId addKeyframe(const Images& images, const Pose& T_map_camera, const Matrix6d& covariance);
  void createLandmarks(KeyframeId id);
  void adjustWindow(KeyframeId id);
  void adjustWhole();
  visual_frontend::BundleSettings bundleSettings() const;
  void finishDepth();

  // ---- loops.cpp
  void fillOrb(const cv::Mat& gray, const cv::Mat& depth, Keyframe& keyframe) const;
  bool closeLoop(KeyframeId id);
  void mergeLandmarks(KeyframeId id, const std::vector<std::pair<int, LandmarkId>>& seen);
};

}  // namespace rgbd_slam
