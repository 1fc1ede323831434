// State of Slam, shared by the files that implement it: slam.cpp (frames in, results out), tracking.cpp (pose of a
// frame), mapping.cpp (keyframes, landmarks, local optimisation) and loops.cpp (places seen before).
#pragma once

#include <set>
#include <utility>

#include "keyframe_trajectory.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

using visual_frontend::Feature;
using visual_frontend::Keyframe;
using visual_frontend::kNoKeyframe;
using visual_frontend::kNoLandmark;
using visual_frontend::kNoTrack;
using visual_frontend::Landmark;
using visual_frontend::LandmarkMatch;
using visual_frontend::LandmarkObservation;
using visual_frontend::Observation;
using visual_frontend::PoseCorrespondence;
using visual_frontend::PoseResult;

struct Slam::Impl {
  Impl(const CameraModel& camera_model, const Mounting& mounted, const SlamSettings& slam_settings);

  // ---- Fixed
  CameraModel camera;
  Mounting mounting;
  SlamSettings settings;
  double focal;  ///< [px]
  Pose T_camera_base;
  Eigen::Matrix3d R_camera_imu = Eigen::Matrix3d::Identity();

  // ---- Sensors
  visual_frontend::FeatureTracker tracker;
  visual_frontend::ImuBuffer imu;
  visual_frontend::AttitudeFilter attitude;
  visual_frontend::InertialAlignment inertial;
  visual_frontend::RollingShutter rows;  ///< with the motion during the present frame
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();
  double gyro_bias_sigma = 0;

  // ---- Map
  visual_frontend::Map map;
  std::unordered_map<TrackId, LandmarkId> track_landmark;
  std::unordered_map<TrackId, std::vector<LandmarkObservation>> track_views;  ///< of tracks without a landmark
  std::map<KeyframeId, Matrix6d> keyframe_covariance;
  std::map<KeyframeId, double> keyframe_path;  ///< way driven until there [m]
  std::map<KeyframeId, KeyframePoints> keyframe_points;
  std::unique_ptr<KeyframeDepth> active_depth;  ///< of the last keyframe, while that is the reference
  KeyframeId reference = kNoKeyframe;           ///< whose view the present frames share
  bool gravity_known = false;
  bool leveled = false;      ///< or nothing to level with
  double tilt_sigma = 0.05;  ///< of the map against gravity, about its origin [rad]
  int map_id = 0;
  SlamCounters counters;

  // ---- Trajectory
  KeyframeTrajectory frames;
  State state = State::kWaiting;
  double first_stamp = -1;
  double last_stamp = -1;
  double strange_since = -1;  ///< lost, the camera sees other places than those of the map [s]
  double last_attempt = -1;   ///< at finding the way back [s]
  std::string lost_reason;    ///< what came of it
  bool nearly_found = false;  ///< some of a place's points agreed, too few to be sure: the next image is worth a look
  double path = 0;
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();   ///< of the camera in the map [m/s]
  Eigen::Vector3d turn_rate = Eigen::Vector3d::Zero();  ///< of the camera, camera frame [rad/s]
  int since_keyframe = 0;
  int since_reobservation = 0;

  // ---- slam.cpp
  FrameResult process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth);
  FrameResult initialize(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth);
  void clear();
  Pose lastPose() const { return frames.lastPose(map); }
  /// Covariance of a pose in the map, with the tilt of the map that all poses share.
  Matrix6d withTilt(const Matrix6d& covariance, const Eigen::Vector3d& position) const;

  // ---- leveling.cpp
  void startInertial();
  /// Gravity and biases from the motion up to this frame.
  void updateInertial(double stamp, const Pose& T_map_camera, const Matrix6d& covariance);
  /// Up in a camera and its standard deviation [rad], to hold a keyframe by.
  std::optional<std::pair<Eigen::Vector3d, double>> upOfCamera(const Eigen::Matrix3d& R_map_camera) const;
  bool levelMap();  ///< when the map leans for certain; true when it turned the map

  // ---- tracking.cpp
  struct Tracked {
    bool success = false;
    std::string reason;
    PoseResult pose;
    int landmarks = 0;
  };
  Tracked track(double stamp, const cv::Mat& gray, const cv::Mat& depth);
  Tracked relocalize(double stamp, const cv::Mat& gray, const cv::Mat& depth);
  Pose predict(double stamp, bool* from_gyro) const;
  /// Motion during the frame at `stamp`, for the rows of the image; the camera is about at `T_map_camera`.
  void setRowMotion(double stamp, const Pose& T_map_camera);
  /// What the camera sees at a pixel, as of the middle row: normalised coordinates, and depth where it is measured.
  /// `inverse_depth`: as far as known otherwise [1/m].
  Observation observe(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized, const cv::Mat& depth,
                      double inverse_depth = 0) const;
  PoseCorrespondence correspondence(const Eigen::Vector3d& p_map, const Eigen::Vector2d& pixel,
                                    const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                    const Pose& T_camera_map) const;
  PoseResult solve(const std::vector<PoseCorrespondence>& c, const Pose& predicted, bool rotation_known) const;
  /// Searches the local map around a pose, refines it with what was found, and starts tracks there.
  int reobserveLocalMap(const Pose& around, double radius, const cv::Mat& depth, PoseResult* pose);
  void updateMotion(double dt, const Pose& T_before, const Pose& T_now);

  // ---- mapping.cpp
  /// Whether a frame with so many landmarks sees other things than the keyframe, by more than the settings allow.
  bool outgrown(const Keyframe& keyframe, const Pose& T_map_camera, int landmarks) const;
  bool keyframeDue(const Pose& T_map_camera, int landmarks) const;
  /// An earlier keyframe whose view a frame has come back to; kNoKeyframe: none.
  KeyframeId keyframeOfView(const Pose& T_map_camera, int landmarks) const;
  void setReference(KeyframeId id);
  /// Takes keyframes out of the map that stood where `id` stands now, so that going about the same ground adds nothing.
  void removeReplacedBy(KeyframeId id);
  KeyframeId addKeyframe(double stamp, const Pose& T_map_camera, const Matrix6d& covariance, const cv::Mat& gray,
                         const cv::Mat& bgr, const cv::Mat& depth);
  void createLandmarks(KeyframeId id);
  void adjustWindow(KeyframeId id);
  void finishDepth();

  // ---- loops.cpp
  void fillOrb(const cv::Mat& gray, const cv::Mat& depth, Keyframe& keyframe) const;
  bool closeLoop(KeyframeId id);
  void mergeLandmarks(KeyframeId id, const std::vector<std::pair<int, LandmarkId>>& seen);
};

}  // namespace rgbd_slam
