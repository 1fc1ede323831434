// The odometry as a conductor: what an image passes through, in odometry.cpp; how a map begins, grows and becomes
// metric, in odometry_map.cpp.
#pragma once

#include <optional>
#include <string>

#include "imu_alignment.h"
#include "inertial_keyframes.h"
#include "keyframe_policy.h"
#include "map_adjuster.h"
#include "map_revision.h"
#include "map_scale.h"
#include "mav_vo/odometry.h"
#include "pose_tracker.h"
#include "relocalizer.h"
#include "visual_frontend/calibration_alignment.h"
#include "visual_frontend/keyframe_covariances.h"

namespace mav_vo {

using visual_frontend::Keyframe;
using visual_frontend::KeyframeId;

struct Odometry::Impl {
  Impl(const CameraModel& camera, const Pose& T_base_camera, const Pose& T_base_imu, const OdometrySettings& settings);

  // ---- odometry.cpp
  VoResult process(double stamp, const cv::Mat& gray);
  void useImu(double stamp);
  void advance(const cv::Mat& gray);
  bool relocalize(const cv::Mat& gray);
  void localized(const cv::Mat& gray, bool continuous);  ///< bookkeeping after a pose was found
  Increment incrementSince(const Pose& T_map_previous) const;
  void fillResult(VoResult* result) const;
  double mapTilt() const;                             ///< of a metric map against gravity, standard deviation [rad]
  air_ground_common::Vertical flownVertical() const;  ///< of a map without IMU
  /// Of the camera's pose; `tilt_stddev`: of mapTilt(), 0 where the map is not metric.
  Matrix6d mapCovariance(double tilt_stddev) const;
  double scaleDeviation() const;  ///< VoResult's
  void reset();

  bool tracking() const;  ///< in a map
  bool metric() const { return inertial.metric(); }
  double mapAge() const;                    ///< [s]
  bool givesUp() const;                     ///< of a lost odometry: a new map is better
  std::string scaleReason() const;          ///< why the map is not metric
  std::string imuReason() const;            ///< why the IMU does not hold a metric map's scale; empty: it does
  std::optional<double> turnSigma() const;  ///< of the rotation that the gyro predicts [rad]
  std::optional<GyroRotation> cameraTurn(double stamp_a, double stamp_b) const;
  double sigma() const { return settings.pixel_sigma / (0.5 * (camera.fx + camera.fy)); }

  // ---- odometry_map.cpp
  void initialize(const cv::Mat& gray);
  void level();     ///< of a map that began without gravity, once it is known
  void startMap();  ///< forgets map and tracks, keeps gyro bias and attitude; a new map id
  bool mapHasBias() const;
  double mapBiasSigma() const;  ///< of the gyro bias that the map's adjustment found [rad/s]
  bool mapBiasRefuted() const;  ///< by the tracks alone
  void leaveRefutedBias();
  void keepMapsBias();
  void addKeyframe(const cv::Mat& gray);
  KeyframeId insertKeyframe(Keyframe keyframe);  ///< with its inertial link
  /// Whether the IMU's motion to a new keyframe is to be believed.
  bool agrees(const Preintegration& motion, const Keyframe& previous, const Keyframe& keyframe);
  Eigen::Vector3d imuVelocity(const Keyframe& keyframe, bool linked) const;  ///< of a new one in the map [m/s]
  void createLandmarks(KeyframeId id);
  void thinKeyframes();
  void makeMetric();
  void transformMap(const air_ground_common::Similarity& S_new_old);
  void retime();
  void turnImu(const Eigen::Matrix3d& R_new_old);
  /// As the map's adjustments have found it.
  Eigen::Matrix3d R_camera_imu() const { return inertial.data().T_camera_imu.linear(); }
  visual_frontend::BundleSettings bundleSettings() const;
  void adjustWholeMap();
  void adjustAnew();  ///< a map that is not metric, at once
  void adopt(const MapAdjuster::Jobs& jobs);
  void recalibrate(const visual_frontend::CalibrationEstimate& estimate);  ///< with its adjustment in the map
  void setReadoutTime(double readout_time);                                ///< as the IMU tells it [s]
  void setCamera(const CameraModel& better_known);
  visual_frontend::CalibrationAlignment givenCalibration() const;
  visual_frontend::VelocityAt velocityAt() const;

  // ---- Fixed
  CameraModel given_camera;
  Pose T_base_camera;
  OdometrySettings settings;

  // ---- Map
  visual_frontend::Map map;
  visual_frontend::LandmarkTracks tracks;
  FrameTrajectory frames;
  visual_frontend::KeyframeCovariances covariances;
  InertialKeyframes inertial;
  MapRevision revision;
  MapAdjuster adjuster;
  MapScale scale;
  std::uint32_t map_id = 1;
  bool levelled = false;    ///< gravity was known when the map began, or has told since what is up
  double metric_since = 0;  ///< [s]

  // ---- Image by image
  CameraModel camera;  ///< as it is known now
  visual_frontend::CalibrationAlignment calibration;
  ImuAlignment imu;
  ImuBias bias;
  PoseTracker pose;
  Bootstrap bootstrap;
  KeyframePolicy policy;
  Relocalizer relocalizer;
  OdometryState state = OdometryState::kWaiting;
  std::string reason = "no image yet";
  std::string imu_problem;
  double last_stamp = -1;              ///< of the last image [s]
  bool relocalized = false;            ///< since the last keyframe
  int contradicted_links = 0;          ///< keyframes to which the IMU told of another motion since it was believed
  int agreeing_links = 0;              ///< the newest in a row to which it tells of the same since then
  std::optional<double> next_readout;  ///< readout time from the next image on, which is predicted with it [s]
  std::optional<Increment> increment;
  bool made_keyframe = false;
};

}  // namespace mav_vo
