// Monocular visual odometry with an inertial unit: from images and IMU samples to metric camera poses in a
// gravity-aligned map (paper A section IV: keyframe VO after Kneip 2011, scale after Nuetzi 2011). Runs synchronously
// unless told otherwise.
#pragma once

#include <cstdint>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/trajectory.h"
#include "air_ground_common/vertical.h"
#include "mav_vo/bootstrap.h"
#include "mav_vo/gyro_alignment.h"
#include "mav_vo/imu_preintegration.h"
#include "mav_vo/increment_covariance.h"
#include "mav_vo/scale_filter.h"
#include "mav_vo/standstill_detector.h"
#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/map.h"
#include "visual_frontend/place_recognition.h"
#include "visual_frontend/realignment.h"
#include "visual_frontend/reobservation.h"
#include "visual_frontend/rolling_shutter.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace mav_vo {

using air_ground_common::CameraModel;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;

/// Covariance of an increment: scatter of five-point solutions between the two images (paper B, III.B), or that of the
/// image noise in both refined poses.
enum class IncrementCovariance { kMonteCarlo, kPoses };

struct OdometrySettings {
  OdometrySettings() { tracker.sparse_distance = 9; }

  visual_frontend::TrackerSettings tracker;
  visual_frontend::ReobservationSettings reobservation;
  visual_frontend::RealignmentSettings realignment;
  visual_frontend::PlaceSettings place;
  BootstrapSettings bootstrap;
  ScaleFilterSettings scale;
  GyroAlignmentSettings gyro_alignment;
  StandstillSettings standstill;
  ImuNoise imu_noise;
  double accel_scale_stddev = 0.01;  ///< of the accelerometer's scale factor: no motion tells it from the map's [1]
  bool use_imu = true;               ///< false: five-point start, no gyro prior, metric by an alignment alone

  double readout_time = 0;            ///< of a rolling shutter, first row to last; stamps are of the middle row [s]
  double readout_time_stddev = 0.02;  ///< of that figure; it is estimated from there; 0 = exact [s]
  double imu_rotation_stddev =
      0.03;                     ///< of the IMU's rotation as mounted, per axis; estimated from there; 0 = exact [rad]
  double radial_stddev = 0.05;  ///< of the calibration's k1; it is estimated from there; 0 = exact [1]
  double pixel_sigma = 0.6;     ///< of a tracked feature [px]
  double gyro_prior_sigma = 0.01;  ///< of the predicted attitude in the pose refinement [rad]
  int min_inliers = 20;            ///< below: the frame is not localised

  double keyframe_distance = 0.10;        ///< since the last keyframe, over the scene's distance [1]
  double keyframe_angle = 0.25;           ///< turn since the last keyframe [rad]
  double keyframe_overlap = 0.65;         ///< share of its landmarks still tracked, below: keyframe [1]
  double keyframe_max_interval = 1.0;     ///< while moving; keeps the inertial links short [s]
  double triangulation_parallax = 0.025;  ///< smallest angle for a new landmark [rad]

  int reobserve_matches = 40;     ///< old landmarks looked for in a frame, at most; 0 = off
  int window = 10;                ///< keyframes the local bundle adjustment moves; up to twice as many, to last
  double window_duration = 5.0;   ///< so long, where the IMU holds the scale: over less time it hardly does [s]
  int window_fixed = 15;          ///< older keyframes that hold it, at most
  int max_image_keyframes = 300;  ///< keyframes that keep their image for patch search; the farthest lose it first
  int local_iterations = 8;
  double full_interval = 2.0;    ///< between adjustments of the whole map, at least; without IMU twice that [s]
  int full_max_keyframes = 120;  ///< the newest of them move in it
  int full_iterations = 12;
  int bundle_threads = 1;

  IncrementCovariance increment_covariance = IncrementCovariance::kMonteCarlo;
  int increment_samples = 1000;  ///< of five correspondences, for kMonteCarlo

  double metric_stddev = 0.02;      ///< relative standard deviation of the scale below which the map is made metric [1]
  double min_metric_keyframes = 6;  ///< and at least as many keyframes
  double max_speed = 5.0;           ///< of the vehicle; bounds how far a place recognised while lost can lie [m/s]
  double relocalization_slack = 0.5;  ///< added to max_speed times the time lost [m]
  double lost_timeout = 4.0;          ///< lost for so long, see Relocalizer: start a new map [s]
  bool synchronous = true;  ///< bundle adjustment inside process(): deterministic; false: on a thread of its own
  /// Beside the tracking: which image has the whole map's adjustment does not depend on the machine's speed, and waits
  /// for it. For recordings, whose player can wait.
  bool reproducible = false;
  unsigned seed = 1;

  /// Throws std::invalid_argument, naming the field, when a value cannot work.
  void validate() const;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, OdometrySettings& settings);

enum class OdometryState { kWaiting, kInitializing, kScaling, kTracking, kLost };

struct Increment {
  double previous_stamp = 0;                   ///< [s]
  Pose T_previous_current = Pose::Identity();  ///< of base_link
  Eigen::Matrix4d covariance =
      Eigen::Matrix4d::Zero();  ///< of (x, y, z, yaw) in the earlier base_link [m^2, m rad, rad^2]
  Eigen::Matrix4d pose_covariance =
      Eigen::Matrix4d::Zero();  ///< that of the image noise in both poses, as IncrementCovariance::kPoses
};

/// What one image gave.
struct VoResult {
  double stamp = 0;  ///< [s]
  OdometryState state = OdometryState::kWaiting;
  std::string reason;                  ///< why not tracking; while it is, what is wrong with the IMU
  bool imu_at_fault = false;           ///< the reason is an IMU that contradicts or misses the images: no motion helps
  bool pose_valid = false;             ///< the poses below are of this image
  Pose T_map_base = Pose::Identity();  ///< [m], or the visual unit while not metric
  Pose T_map_camera = Pose::Identity();
  Matrix6d covariance = Matrix6d::Zero();              ///< of T_map_base (x y z rotX rotY rotZ) in the map
  Matrix6d camera_covariance = Matrix6d::Zero();       ///< of T_map_camera
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< of the IMU in the map [m/s]; zero while not metric
  std::optional<Increment> increment;  ///< since the last localised image; none right after a (re)start or jump
  bool metric = false;
  bool keyframe = false;
  int tracked = 0;                      ///< features tracked into this image
  int inliers = 0;                      ///< landmarks that agree with the pose
  double depth_min = 0, depth_max = 0;  ///< 5 % and 95 % quantile of the landmarks' depth [m]; 0 unknown
  double scale = 1, scale_stddev = 0;   ///< metric over map unit; the deviation is infinite while unknown
  /// Relative deviation of lengths in a metric map, with what `scale` says by now that they are off; 0 while not
  /// metric.
  double scale_deviation = 0;
  std::uint32_t map_revision = 0;     ///< counts changes of the calibration: what earlier poses made is off
  std::uint32_t map_corrections = 0;  ///< counts changes of earlier poses by more than 0.2 % of the scene's distance
  /// Up in the map: its z axis where it is level; without IMU, what the vehicle's level flight tells.
  air_ground_common::Vertical vertical;
  ImuBias imu_bias;                ///< as used for this image
  double gyro_bias_stddev = 0;     ///< of the least certain axis [rad/s]
  double time_offset = 0;          ///< t_imu = t_image + time_offset, of the same instant on both clocks [s]
  double time_offset_stddev = 0;   ///< [s]; 0 = given, not estimated
  double readout_time = 0;         ///< of a rolling shutter, as it is in use [s]
  double readout_time_stddev = 0;  ///< of its estimate [s]; 0 = given, not estimated
  /// Turns what the IMU reads into the axes that T_base_imu was given for, as it is in use.
  Eigen::Matrix3d R_given_imu = Eigen::Matrix3d::Identity();
  double accel_noise = 0;          ///< density in use: as given, or as its samples show [m/s^2/sqrt(Hz)]; 0 without IMU
  double imu_rotation_stddev = 0;  ///< of its estimate, of the least certain axis [rad]; 0 = given, not estimated
  std::uint32_t map_id = 0;
  std::size_t keyframes = 0, landmarks = 0;
  double seconds = 0;  ///< processing time
};

class Odometry {
 public:
  /// Fixed transforms: poses of the camera and the IMU in base_link [m]. Throws std::invalid_argument for bad input.
  Odometry(const CameraModel& camera, const Pose& T_base_camera, const Pose& T_base_imu,
           const OdometrySettings& settings);
  ~Odometry();

  /// False when the sample is dropped: not finite or not newer than the last. Feed samples up to imuNeededAt(an image's
  /// stamp) before it.
  bool addImu(const ImuSample& sample);

  /// Not empty: the accelerometer cannot be right (its unit, say). The map does not become metric, and results say so.
  void setImuProblem(const std::string& problem);

  /// Stamp up to which the IMU's samples are needed before the image of this stamp is processed [s].
  double imuNeededAt(double image_stamp) const;

  /// Next image, CV_8UC1 of the camera's size (std::invalid_argument otherwise). Stamps must increase; an image that
  /// does not is answered with the last state and no pose.
  VoResult process(double stamp, const cv::Mat& gray);

  /// Forgets everything and takes a new map id.
  void reset();

  const CameraModel& camera() const;  ///< the given one, or what the images make of it (radial_stddev)
  const visual_frontend::Map& map() const;
  const std::vector<visual_frontend::Feature>& features() const;
  /// For each of features(): it has a landmark.
  std::vector<bool> mappedFeatures() const;
  /// Camera poses of all localised images of the present map, as its keyframes place them now; metric once the map is.
  air_ground_common::Trajectory trajectory() const;
  bool metric() const;
  std::uint32_t mapId() const;
  /// Waits for a bundle adjustment that runs on its own thread and takes its result over.
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

const char* toString(OdometryState state);

}  // namespace mav_vo
