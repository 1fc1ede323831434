// State of the odometry, shared by odometry.cpp (one image after the other), odometry_start.cpp (bias, gravity, first
// views), odometry_tracking.cpp (the image's pose and its covariance), odometry_mapping.cpp (keyframes, landmarks,
// metric map) and odometry_adjustment.cpp (bundle adjustment, scale of the adjusted map).
#pragma once

#include <map>
#include <memory>
#include <unordered_map>

#include "adjustment_threads.h"
#include "imu_alignment.h"
#include "map_revision.h"
#include "map_scale.h"
#include "mav_vo/odometry.h"
#include "visual_frontend/keyframe_covariances.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/pose_solver.h"

namespace mav_vo {

using visual_frontend::BundleJob;
using visual_frontend::Feature;
using visual_frontend::Keyframe;
using visual_frontend::KeyframeId;
using visual_frontend::LandmarkId;
using visual_frontend::LandmarkObservation;
using visual_frontend::PoseCorrespondence;
using visual_frontend::PoseResult;
using visual_frontend::TrackId;

constexpr double kMapTilt = 0.002;  // of the adjusted map as a whole, against gravity [rad]

struct Odometry::Impl {
  Impl(const CameraModel& camera, const Pose& T_base_camera, const Pose& T_base_imu, const OdometrySettings& settings);

  // odometry.cpp: one image
  FrameResult process(double stamp, const cv::Mat& gray);
  bool tracking() const;  ///< in a map
  Pose predict(double stamp, visual_frontend::TrackPrediction* prediction);
  void useImu(double stamp);
  void advance(const cv::Mat& gray);
  void localized(bool continuous);  ///< bookkeeping after a pose was found
  void fillResult(FrameResult* result) const;
  double patience() const;  ///< of a lost odometry, before a new map starts [s]
  void startMap();          ///< forgets map and tracks, keeps gyro bias and attitude; a new map id
  void reset();
  std::optional<LandmarkId> landmarkOf(TrackId track) const;
  void followShutter(double stamp, const Pose& predicted);  ///< motion of the camera during the image
  Eigen::Vector2d rayOf(const Feature& feature) const;      ///< normalised, as the middle row would see it
  std::vector<Feature> currentFeatures() const;             ///< with such rays

  // odometry_start.cpp
  void alignImu(double stamp);  ///< gyro bias, time offset and readout time from the tracks
  void keepMapsBias();          ///< before a map is given up: what its adjustment knows of the gyro
  std::optional<GyroRotation> cameraTurn(double stamp_a, double stamp_b) const;
  void levelFirstViews(const BootstrapResult& start, Pose* T_map_first, double* tilt) const;
  void initialize();
  double mapAge() const;            ///< [s]
  std::string scaleReason() const;  ///< why the map is not metric

  // odometry_tracking.cpp
  bool locate(bool gyro);  ///< pose of the current image from tracked landmarks
  bool relocalize(const cv::Mat& gray, bool gyro);
  void lookForOldLandmarks(const visual_frontend::ReobservationSettings& how);
  std::vector<PoseCorrespondence> correspondences(std::vector<TrackId>* seen) const;
  Increment incrementSince(const Pose& T_map_previous) const;
  void scatterCovariance(const Eigen::Matrix3d& R_map_base, Increment* step) const;
  Matrix6d mapCovariance(const Matrix6d& camera_covariance) const;

  // odometry_mapping.cpp
  bool needsKeyframe() const;
  bool moved(const Keyframe& since) const;  ///< enough to see anything new
  void addKeyframe();
  void insertKeyframe(Keyframe keyframe);  ///< with its inertial link
  bool contradicts(const Preintegration& motion, KeyframeId previous, const Keyframe& keyframe) const;
  void thinKeyframes();  ///< of places that are seen again and again
  void triangulateTracks(KeyframeId id);
  void makeMetric();
  void startVelocities();
  void scaleIncrement(double factor);
  void transformMap(const air_ground_common::Similarity& S_new_old);

  // odometry_adjustment.cpp
  void adjustLocally();
  void adjustFully();
  void run(BundleJob job);
  void adopt(const BundleJob& job);
  void adoptDue();    ///< of adjustments beside the tracking, what this image must have
  void adoptLocal();  ///< waits
  void adoptAll();    ///< waits
  void retime();      ///< the inertial motion between images, after a change of the time offset
  visual_frontend::BundleSettings bundleSettings(int iterations, double max_seconds) const;

  double sigma() const { return settings.pixel_sigma / (0.5 * (camera.fx + camera.fy)); }

  CameraModel camera;
  Pose T_base_camera, T_camera_imu;
  OdometrySettings settings;

  visual_frontend::FeatureTracker tracker;
  visual_frontend::RollingShutter shutter;
  Bootstrap bootstrap;
  MapScale scale;
  ImuAlignment imu;
  ImuBias bias;

  visual_frontend::Map map;
  MapRevision revision;
  visual_frontend::InertialMap inertial;
  visual_frontend::LandmarkTracks tracks;

  visual_frontend::KeyframeCovariances covariances;
  bool relocalized = false;  ///< since the last keyframe
  bool hovering = false;     ///< the last keyframe saw what the one before it saw

  OdometryState state = OdometryState::kWaiting;
  std::string reason = "no image yet";
  std::string imu_problem;
  std::uint32_t map_id = 1;
  bool metric = false;
  double metric_since = 0;
  double next_full = 0, full_interval = 0;

  double last_stamp = -1;                ///< of the last image [s]
  double located_stamp = -1;             ///< of the last localised one [s]
  Pose T_map_camera = Pose::Identity();  ///< at located_stamp
  Eigen::Vector3d velocity =
      Eigen::Vector3d::Zero();  ///< of the camera in the map [unit/s], constant-velocity prediction
  Eigen::Vector3d turn_rate = Eigen::Vector3d::Zero();  ///< of the camera, by its last two poses, own axes [rad/s]
  PoseResult last_pose;
  Matrix6d previous_covariance = Matrix6d::Zero();
  double lost_since = 0;
  int frames_lost = 0;
  double scene_distance = 1;
  int keyframe_landmarks = 0;  ///< tracked landmarks when the last keyframe was made
  int inliers = 0;
  double depth_min = 0, depth_max = 0;
  std::optional<Increment> increment;
  bool made_keyframe = false;
  std::optional<Eigen::Matrix3d> R_previous_current;  ///< of the camera, from the gyro

  FrameTrajectory frames;
  AdjustmentThreads adjustments;
  const cv::Mat* image = nullptr;  ///< the one being processed
};

}  // namespace mav_vo
