// RGB-D SLAM of the ground robot (Forster 2013, section IV): the monocular front end with depth as a prior, a map of
// keyframes and landmarks, loop closure, and the dense ground cloud.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "air_ground_common/trajectory.h"
#include "air_ground_common/vertical.h"
#include "rgbd_slam/depth_model.h"
#include "rgbd_slam/ground_cloud.h"
#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/imu_attitude.h"
#include "visual_frontend/inertial_alignment.h"
#include "visual_frontend/map.h"
#include "visual_frontend/place_recognition.h"
#include "visual_frontend/pose_graph.h"
#include "visual_frontend/realignment.h"
#include "visual_frontend/reobservation.h"
#include "visual_frontend/rolling_shutter.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace rgbd_slam {

using air_ground_common::CameraModel;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::Vertical;
using visual_frontend::KeyframeId;
using visual_frontend::LandmarkId;
using visual_frontend::TrackId;

constexpr double kLongestDepthDelay = 0.1;  ///< from so long on the camera's motion is not made up for [s]

struct SlamSettings {
  SlamSettings();

  visual_frontend::TrackerSettings tracker;
  DepthModel depth;
  double pixel_sigma = 0.7;  ///< of a tracked feature [px]

  // Time
  double time_offset = 0;   ///< the IMU's stamps less the images': a sample was taken at its stamp less this [s]
  double readout_time = 0;  ///< of a rolling shutter, colour and depth alike: row r is exposed at (each one's own)
                            ///< stamp + (r / height - 0.5) * readout_time [s]; negative: from the last row up
  double readout_time_stddev = 0.02;  ///< of that figure; it is estimated from there; 0 = exact [s]

  double radial_stddev = 0.05;  ///< of the colour calibration's k1; it is estimated from there; 0 = exact [1]

  // Start
  int min_start_features = 40;   ///< features with depth that the first frame must have
  double gravity_timeout = 1.0;  ///< with an IMU: wait this long for the direction of gravity [s]

  // Tracking
  int min_inliers = 15;            ///< fewer make the frame lost
  double min_inlier_ratio = 0.25;  ///< of the tracked landmarks
  visual_frontend::RealignmentSettings realignment;
  int reobserve_every = 3;  ///< frames between searches for landmarks of the local map, keyframes always do; 0 = never
  int local_keyframes = 8;  ///< nearest keyframes whose landmarks are searched
  double max_speed = 3.0;   ///< a faster motion between frames is taken for a failure [m/s]
  double relocalization_slack =
      0.5;  ///< a place recognised while lost may lie this and max_speed times the time lost away [m]

  /// Surfaces that depth shows bind keyframes to each other, and give the pose where too few landmarks agree.
  bool use_surfaces = true;

  double relocalization_interval = 0.1;  ///< while lost, places are looked up so often, by the images' stamps [s]

  // Keyframes
  double keyframe_translation = 0.15;  ///< distance to the last keyframe, over the median depth
  double keyframe_rotation = 0.20;     ///< angle to the last keyframe [rad]
  double keyframe_overlap = 0.55;      ///< landmarks of the last keyframe still tracked, as a share
  int keyframe_min_gap = 3;            ///< frames

  // Mapping
  visual_frontend::BundleSettings bundle;
  int window = 7;               ///< keyframes free in the windowed bundle adjustment
  int window_fixed = 10;        ///< further keyframes that hold it
  bool use_gravity = true;      ///< roll and pitch priors from the accelerometer
  double gravity_sigma = 0.08;  ///< of those while moving, at least: accelerations look like tilt [rad]
  visual_frontend::InertialAlignmentSettings inertial;
  double level_tolerance = 0.005;  ///< the map is levelled anew when it leans by more [rad]

  // Loops
  bool loop_closure = true;
  visual_frontend::PlaceSettings place;
  int loop_min_gap = 12;  ///< keyframes between the two ends of a loop
  int loop_min_inliers = 30;
  double loop_slack = 0.15;         ///< a loop may move the camera by this [m]
  double loop_drift = 0.05;         ///< plus this share of the way between its ends; others are refused as false
  double loop_max_rotation = 0.35;  ///< and may turn it by this [rad]

  // Dense cloud
  CloudSettings cloud;
  int max_image_keyframes = 300;  ///< keyframes that keep their image for patch search; the farthest lose it first
  int max_fused_frames = 12;      ///< frames after a keyframe that refine its depth

  bool synchronous = true;  ///< adjustments of the whole map inside process(): false: on a thread of their own
  /// Beside the tracking: which frame has the result does not depend on the machine's speed, and waits for it; no
  /// adjustment ends by the clock. For recordings, whose player can wait.
  bool reproducible = false;

  /// Lost, and for so long images showed enough to begin a map, but no known place: begin a new map [s]; 0 = never
  double restart_after = 5;

  /// Throws std::invalid_argument, naming the field.
  void validate() const;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, SlamSettings& settings);

/// Where sensors sit on the robot. Base: x forward, y left, z up.
struct Mounting {
  Pose T_base_camera = Pose::Identity();
  std::optional<Eigen::Matrix3d> R_base_imu;             ///< none: no IMU is used
  Eigen::Vector3d p_base_imu = Eigen::Vector3d::Zero();  ///< its place: turning, it feels accelerations there [m]
};

enum class State { kWaiting, kInitializing, kTracking, kLost };

/// What is left of a map that the robot goes on without.
struct EndedMap {
  air_ground_common::Trajectory trajectory;  ///< of the camera
  std::vector<PosedPoints> points;           ///< for fusePoints
};

struct SlamResult {
  State state = State::kWaiting;
  std::string reason;       ///< why not tracking
  std::string imu_problem;  ///< why the IMU, or what contradicts of it, is left out, and what to do; empty: it is not
  bool keyframe = false;
  bool map_corrected = false;            ///< earlier poses moved: loop closed, map adjusted or levelled, shutter or
                                         ///< lens found
  bool recalibrated = false;             ///< what earlier keyframes saw lies elsewhere in their cameras
  bool points_gone = false;              ///< what posedPoints has of earlier keyframes is less: things went away
  bool relocalized = false;              ///< found again after being lost
  bool by_depth = false;                 ///< too few landmarks: the pose is that of the surfaces
  bool new_map = false;                  ///< the map frame starts here
  Pose T_map_camera = Pose::Identity();  ///< valid while tracking
  Pose T_map_base = Pose::Identity();
  Pose T_previous_current_base = Pose::Identity();  ///< motion since the last tracked frame, free of map corrections
  Matrix6d covariance = Matrix6d::Zero();           ///< of T_map_base's translation and rotation about the map's axes
  /// Of T_previous_current_base, about the axes of the earlier base: twice what this frame's noise tells stands for
  /// both frames. None after a loss.
  std::optional<Matrix6d> increment_covariance;
  int tracked = 0;  ///< features that reached this frame
  int inliers = 0;  ///< landmarks that agree with the pose
  double rms = 0;   ///< their reprojection error [sigma]
  /// Lost for too long, the robot goes on without this map. Null: none.
  std::shared_ptr<const EndedMap> ended;
};

struct SlamCounters {
  int frames = 0, lost_frames = 0, keyframes = 0, loops = 0, loops_refused = 0, relocalizations = 0, maps = 0;
  int by_depth = 0;                 ///< frames whose pose is that of the surfaces
  int depth_carried = 0;            ///< frames whose depth was carried to the colour image's time
  int relocalization_attempts = 0;  ///< frames in which places were looked up
};

class Slam {
 public:
  /// Throws std::invalid_argument for a bad camera, mounting or settings.
  Slam(const CameraModel& camera, const Mounting& mounting, const SlamSettings& settings);
  ~Slam();

  /// In order of time; samples between two frames must come before the second for the rotation prior. False: dropped.
  bool addImu(const visual_frontend::ImuSample& sample);

  /// Next frame: grey CV_8UC1, `bgr` CV_8UC3 (empty: grey is used) and depth CV_32F in metres (NaN or 0 unknown), all
  /// of the camera's size and registered. `depth_delay`: depth was taken so long after the colour image [s], before it
  /// if negative, row by row as that one; its pixels are carried to the colour's time by the camera's motion where that
  /// moves them by half a pixel. Within 1 ms, from kLongestDepthDelay on and where not finite it counts as 0; so it
  /// does while no motion is known. Throws std::invalid_argument for other types or a stamp that is not newer.
  SlamResult process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth,
                     double depth_delay = 0);

  /// Waits for the adjustment that runs beside the tracking, for seconds where the map is large. True: it has moved the
  /// map.
  bool finish();
  /// Takes it over if an image a second later would; live, that one waits for nothing. True: it has moved the map.
  bool adoptFinished();
  bool adjusting() const;  ///< such an adjustment runs, or its result has not been taken over

  /// Camera poses of all tracked frames in the map, placed by their keyframes as those stand now.
  air_ground_common::Trajectory trajectory() const;

  /// What fusePoints needs: posed points of all keyframes.
  std::vector<PosedPoints> posedPoints() const;

  /// The map as it stands: what would be lost with it.
  EndedMap asEnded() const;

  const CameraModel& camera() const;  ///< the given one, or what the images make of it (radial_stddev)
  const visual_frontend::Map& map() const;
  const std::vector<visual_frontend::Feature>& features() const;
  /// One flag for each of features(): it has a landmark.
  std::vector<bool> mapped() const;
  const SlamCounters& counters() const;
  Eigen::Vector3d gyroBias() const;  ///< estimate [rad/s]
  bool gravityKnown() const;         ///< the map was levelled by the accelerometer
  bool levelBySurfaces() const;      ///< no accelerometer serves: the map is as level as what lies flat in it
  double readoutTime() const;        ///< of a rolling shutter, as it is in use [s]
  double readoutTimeStddev() const;  ///< of its estimate [s]; 0 = given, not estimated
  Vertical vertical() const;         ///< what is up in the map, which leans a little (`level_tolerance`)
  /// Gravity and biases from the motion so far; empty without IMU or before there was any.
  std::optional<visual_frontend::InertialEstimate> inertialEstimate() const;
  int mapId() const;  ///< counts the maps that were begun

  /// Forgets everything except counters and the map's number.
  void reset();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

const char* toString(State state);

}  // namespace rgbd_slam
