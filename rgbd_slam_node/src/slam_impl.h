// Slam as a conductor: what a frame passes through, in slam.cpp; how the map grows and is corrected, in slam_map.cpp.
#pragma once

#include "camera_motion.h"
#include "dense_keyframes.h"
#include "depth_carrier.h"
#include "frame_tracker.h"
#include "keyframe_surfaces.h"
#include "loop_closer.h"
#include "map_level.h"
#include "place_search.h"
#include "reference_keyframe.h"
#include "rgbd_slam/rotation_check.h"
#include "rgbd_slam/slam.h"
#include "shutter_alignment.h"
#include "visual_frontend/calibration_alignment.h"
#include "visual_frontend/keyframe_covariances.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/whole_map_thread.h"

namespace rgbd_slam {

using visual_frontend::Keyframe;
using visual_frontend::kNoKeyframe;

constexpr std::size_t kCalibrationKeyframes = 10;  ///< of a map whose calibration is looked at first

struct Slam::Impl {
  Impl(const CameraModel& camera_model, const Mounting& mounted, const SlamSettings& slam_settings);

  // ---- slam.cpp
  SlamResult process(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth, double depth_delay);
  void check(double stamp, const cv::Mat& gray, const cv::Mat& bgr, const cv::Mat& depth) const;
  /// Depth as of the image's time; as it came where the stamps agree, cannot be true, or no motion is known.
  cv::Mat carriedTo(double stamp, const cv::Mat& depth, double depth_delay);
  SlamResult follow(const RgbdImages& images);  ///< a frame after the first of a map
  SlamResult initialize(const RgbdImages& images);
  /// Attitude of the first base in its map: level as gravity says it, if `levelled`, and yaw 0.
  Eigen::Matrix3d firstAttitude(bool levelled) const;
  std::string imuProblem() const;  ///< empty: it serves, or there is none
  TrackedPose relocalize(const RgbdImages& images);
  TrackedPose relocalizeByImages(const RgbdImages& images);
  visual_frontend::PlaceMatch recognize(const RgbdImages& images, Keyframe* query);
  /// It stood when it was lost, and stands still: what is strange before the lens has come there.
  bool hasStoodSinceLost(double stamp) const;
  void beLost(SlamResult* result);
  EndedMap asEnded() const { return {frames.poses(map), dense.posed(map)}; }
  /// Compares the turn from the last frame to this one with the gyro's, and goes on without a gyro that contradicts.
  void compareTurns(double stamp, const Pose& T_map_camera);
  /// Takes the step from the last frame to this one; returns what the base moved by.
  Pose step(double stamp, const Pose& T_map_camera, bool relocalized);
  void concludePose(const Matrix6d& camera_covariance, const Matrix6d& frame_covariance, SlamResult* result) const;
  void clear();
  Pose lastPose() const { return frames.lastPose(map); }
  Pose firstBase() const { return map.keyframes().begin()->second.T_map_camera * T_camera_base; }  ///< in the map

  // ---- slam_map.cpp
  /// Keeps the frame, in the view of a keyframe there is or as a new one.
  void addToMap(const RgbdImages& images, const TrackedPose& tracked, SlamResult* result);
  /// Takes out of one of the keyframes that share the frame's view, by turns, what is there no more; true: something.
  bool lookThrough(const cv::Mat& depth, const Pose& T_map_camera);
  /// The keyframe there is whose view a frame has; kNoKeyframe: it needs one of its own.
  KeyframeId keyframeOfView(const RgbdImages& images, const TrackedPose& tracked, bool relocalized);
  int featuresWithDepth(const RgbdImages& images) const;
  KeyframeId addKeyframe(const RgbdImages& images, const TrackedPose& tracked);
  void describe(const RgbdImages& images, Keyframe& keyframe) const;  ///< for place recognition
  void createLandmarks(KeyframeId id);
  void linkBySurfaces(KeyframeId id);
  void setReference(KeyframeId id);
  /// Takes keyframes out of the map that stood where `id` stands now, so that going about the same ground adds nothing.
  void removeReplacedBy(KeyframeId id);
  bool closeLoop(KeyframeId id);                ///< true when it moved the map
  bool alignShutter(const RgbdImages& images);  ///< likewise
  bool alignCalibration();                      ///< likewise
  bool levelMap();                              ///< likewise
  std::optional<MapLevel::Correction> levelBySurfaces();
  void setCamera(const CameraModel& better_known);
  void adjustWindow(KeyframeId id);
  visual_frontend::BundleJob wholeMap() const;
  void adjustWhole();             ///< beside the tracking, unless `synchronous`
  void adjustWholeAtOnce();       ///< instead of what runs beside the tracking
  bool adoptWhole(double stamp);  ///< what this frame must have of it; true when it moved the map
  bool takeWhole();               ///< waits for it; likewise
  visual_frontend::BundleSettings bundleSettings() const;

  // ---- Fixed
  CameraModel given_camera;
  Mounting mounting;
  SlamSettings settings;
  Pose T_camera_base;

  // ---- Map
  visual_frontend::Map map;
  visual_frontend::LandmarkTracks tracks;
  Frames frames;
  visual_frontend::KeyframeCovariances covariances;
  MapLevel level;
  LoopCloser loops;
  DenseKeyframes dense;
  KeyframeSurfaces surfaces;
  ReferenceKeyframe reference;
  visual_frontend::WholeMapThread whole;  ///< cancelled: it began before the map was moved, and is to begin again
  int map_id = 0;

  // ---- Frame by frame
  CameraModel camera;  ///< as it is known now
  visual_frontend::CalibrationAlignment calibration;
  std::size_t next_calibration = 0;  ///< keyframes of the map at which it is looked at again
  std::size_t next_levelling = 1;    ///< likewise by surfaces, where no accelerometer levels
  CameraMotion motion;
  DepthCarrier carrier;
  FrameTracker tracking;
  RotationCheck turns;       ///< gyro against images
  bool upside_down = false;  ///< the accelerometer said so as the map began
  ShutterAlignment shutter;
  PlaceSearch search;
  SlamCounters counters;
  State state = State::kWaiting;
  double first_stamp = -1, last_stamp = -1;  ///< [s]
};

}  // namespace rgbd_slam
