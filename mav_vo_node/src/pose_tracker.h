// Pose of the camera in each image: features are followed into it, and those of landmarks tell where it is.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "mav_vo/odometry.h"
#include "visual_frontend/image_intervals.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/pose_solver.h"

namespace mav_vo {

using visual_frontend::PoseResult;
using visual_frontend::TrackId;

class PoseTracker {
 public:
  /// `map` and `tracks` are those of the odometry, and outlive this.
  PoseTracker(const CameraModel& camera, const OdometrySettings& settings, const visual_frontend::Map& map,
              visual_frontend::LandmarkTracks& tracks, GyroRotations turn);

  /// For another map: tracks, pose and motion are forgotten.
  void reset();
  /// Follows the features from the image of `last_stamp` into the one of `stamp`. `tracking`: the camera was found in
  /// the last one, and its motion tells where to look for them.
  void track(double last_stamp, double stamp, const cv::Mat& gray, bool tracking);
  /// Finds the pose of the image from its landmarks. `turn_sigma`: of the predicted rotation, by the gyro [rad]; none:
  /// not known. Landmarks that disagree lose their tracks. False, `result().reason` says why: the pose is as before.
  bool locate(const std::optional<double>& turn_sigma);
  /// Before that: puts the tracks back to where the keyframes' images show their points, for they drift.
  void realign();
  /// The pose found stands; T_map_previous: of the last image that was located, right before; none: not known.
  void settle(double stamp, const std::optional<Pose>& T_map_previous);
  /// Looks around the pose for landmarks that have no track.
  void reobserve(const visual_frontend::ReobservationSettings& how);

  /// Lost, the camera flies on all the same: `dt` [s] further, as it did, by the gyro's turn where that is known.
  void coast(double dt);
  /// Begins all tracks anew in the image, from landmarks as they are seen from a pose.
  void beginAround(const Pose& T_map_camera, const cv::Mat& gray, const visual_frontend::ReobservationSettings& how);
  /// The first views' map is at hand.
  void beginMap(const Pose& T_map_camera, const Eigen::Vector3d& velocity);
  /// As the corrected map has it.
  void setPose(const Pose& T_map_camera) { T_map_camera_ = T_map_camera; }
  /// With Map::transform; the pose comes with the trajectory.
  void transform(const air_ground_common::Similarity& S_new_old);

  const Pose& pose() const { return T_map_camera_; }        ///< T_map_camera
  double speed() const { return motion_.velocity.norm(); }  ///< when it was last located [map unit/s]
  double locatedStamp() const { return located_stamp_; }    ///< of the last image that was located [s]; -1: none
  const PoseResult& result() const { return result_; }      ///< of locate()
  const Matrix6d& previousCovariance() const { return previous_covariance_; }  ///< of the pose before
  double sceneDistance() const { return scene_distance_; }  ///< median depth of the landmarks in view
  double depthMin() const { return depth_min_; }            ///< their 5 % quantile; 0: not known
  double depthMax() const { return depth_max_; }            ///< their 95 % quantile; 0: not known
  const std::optional<Eigen::Matrix3d>& turnSincePrevious() const { return R_previous_current_; }  ///< by the gyro

  visual_frontend::FeatureTracker& tracker() { return tracker_; }
  const visual_frontend::FeatureTracker& tracker() const { return tracker_; }
  /// Features with rays as the middle row would see them.
  std::vector<visual_frontend::Feature> currentFeatures() const;
  /// What they show, as a keyframe has it.
  std::vector<visual_frontend::Observation> observations() const;
  double readoutTime() const { return shutter_.readoutTime(); }  ///< [s]
  void setReadoutTime(double readout_time) { shutter_.setReadoutTime(readout_time); }
  void setCamera(const CameraModel& camera);  ///< the same, better known

 private:
  Pose predict(double last_stamp, double stamp, bool tracking, visual_frontend::TrackPrediction* prediction);
  void followShutter(double stamp, const Pose& predicted);  ///< motion of the camera during the image
  Eigen::Vector2d rayOf(const visual_frontend::Feature& feature) const;
  std::vector<visual_frontend::PoseCorrespondence> correspondences(std::vector<TrackId>* seen) const;
  using Correspondences = std::vector<visual_frontend::PoseCorrespondence>;
  PoseResult solve(const Correspondences& points, const std::optional<double>& turn_sigma) const;
  PoseResult search(const Correspondences& points, bool turn_known) const;
  bool chooseMotion(const Correspondences& points, bool turn_known, PoseResult* found) const;

  CameraModel camera_;
  OdometrySettings settings_;
  const visual_frontend::Map& map_;
  visual_frontend::LandmarkTracks& tracks_;
  GyroRotations turn_;
  visual_frontend::FeatureTracker tracker_;
  visual_frontend::RollingShutter shutter_;

  Pose T_map_camera_ = Pose::Identity();
  bool predicted_ = false;  // the pose before locate() is where the motion leads
  double located_stamp_ = -1;
  visual_frontend::ImageIntervals intervals_;  // of the last images that were located
  struct Motion {
    Eigen::Vector3d velocity = Eigen::Vector3d::Zero();   // of the camera in the map [unit/s]
    Eigen::Vector3d turn_rate = Eigen::Vector3d::Zero();  // of the camera, own axes [rad/s]
  };
  Motion motion_;  // by the last two poses
  Motion steady_;  // over several images: during one
  PoseResult result_;
  Matrix6d previous_covariance_ = Matrix6d::Zero();
  double scene_distance_ = 1, depth_min_ = 0, depth_max_ = 0;
  std::optional<Eigen::Matrix3d> R_previous_current_;
};

}  // namespace mav_vo
