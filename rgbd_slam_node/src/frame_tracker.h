// Pose of a frame: KLT tracks of landmarks, P2P RANSAC with the gyro's rotation, motion-only refinement, and search for
// landmarks of the local map that have no track.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "camera_motion.h"
#include "keyframe_surfaces.h"
#include "reference_keyframe.h"
#include "rgbd_slam/slam.h"
#include "visual_frontend/keyframe_trajectory.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/place_recognition.h"
#include "visual_frontend/pose_solver.h"

namespace rgbd_slam {

using Frames = visual_frontend::KeyframeTrajectory<visual_frontend::CompactPose>;

/// What the camera saw at a time [s].
struct RgbdImages {
  double stamp;
  const cv::Mat &gray, &colour, &depth;
};

struct TrackedPose {
  bool success = false;
  std::string reason;  ///< why not
  visual_frontend::PoseResult pose;
  int landmarks = 0;      ///< that are tracked
  bool by_depth = false;  ///< too few landmarks agreed: the surfaces that depth shows gave the pose
};

/// What the camera sees at a pixel, as of the middle row: normalised coordinates, and depth where it is measured.
/// `inverse_depth`: as far as known otherwise [1/m].
visual_frontend::Observation observe(const Eigen::Vector2d& pixel, const Eigen::Vector2d& normalized,
                                     const cv::Mat& depth, const DepthModel& model,
                                     const visual_frontend::RollingShutter& rows, double inverse_depth = 0);

class FrameTracker {
 public:
  /// `map`, `frames`, `tracks`, `surfaces` and `motion` are those of the SLAM, and outlive this.
  FrameTracker(const CameraModel& camera, const SlamSettings& settings, const visual_frontend::Map& map,
               const Frames& frames, visual_frontend::LandmarkTracks& tracks, const KeyframeSurfaces& surfaces,
               CameraMotion& motion);

  void setCamera(const CameraModel& camera);  ///< the same, better known
  void reset();                               ///< tracks are forgotten
  void restart(const cv::Mat& gray);          ///< and begin with this image
  /// Pose after the last frame's.
  TrackedPose track(const RgbdImages& images, const ReferenceKeyframe& reference);
  /// Not far from where it was, the camera is found by the local map; `restart` first.
  TrackedPose findNearLast(const RgbdImages& images);
  /// Just after it was lost: by the surfaces of the reference keyframe, as where landmarks are too few while tracking.
  TrackedPose findByDepth(const RgbdImages& images, KeyframeId reference);
  /// At a recognised place whose keyframes have lost their images: by the features that were recognised; `restart`
  /// first.
  TrackedPose findByFeatures(const visual_frontend::Keyframe& query, const visual_frontend::PlaceMatch& match,
                             const Pose& T_map_camera, const RgbdImages& images);
  /// Searches the local map around a pose within `radius` [px]; without success no track is left.
  TrackedPose findAround(const Pose& T_map_camera, double radius, const RgbdImages& images);
  /// The next search for landmarks without a track is a whole interval away.
  void postponeReobservation() { since_reobservation_ = 0; }
  /// What the features show, as a keyframe at this pose has it.
  std::vector<visual_frontend::Observation> observations(const Pose& T_map_camera, const cv::Mat& depth) const;

  visual_frontend::FeatureTracker& tracker() { return tracker_; }
  const visual_frontend::FeatureTracker& tracker() const { return tracker_; }

 private:
  using Correspondences = std::vector<visual_frontend::PoseCorrespondence>;

  /// Follows the features into the image, those of landmarks from where they are expected.
  void follow(const RgbdImages& images, const Pose& T_map_predicted);
  /// Of the tracked landmarks; `ids`: their tracks.
  Correspondences correspondences(const cv::Mat& depth, const Pose& T_camera_map, std::vector<TrackId>* ids) const;
  visual_frontend::PoseCorrespondence correspondence(LandmarkId landmark, const Eigen::Vector2d& pixel,
                                                     const Eigen::Vector2d& normalized, const cv::Mat& depth,
                                                     const Pose& T_camera_map) const;
  visual_frontend::PoseResult solve(const Correspondences& c, const Pose& predicted, bool rotation_known) const;
  /// Where the pose of most landmarks contradicts the surfaces, that of the others that agree, if it does not: most may
  /// be on one thing that moves by itself.
  void preferBackground(const Correspondences& c, const Pose& predicted, bool rotation_known, KeyframeId reference,
                        const cv::Mat& depth, visual_frontend::PoseResult* pose) const;
  /// Where the reference keyframe's surfaces place the camera, from `predicted`; none: they do not lie upon each other.
  std::optional<visual_frontend::PosePrior> placedBySurfaces(const Pose& predicted, KeyframeId reference,
                                                             const cv::Mat& depth) const;
  /// Where the reference keyframe's surfaces place the camera, together with what landmarks and, with a rotation known
  /// to `rotation_sigma` [rad] (0: it is not), the gyro tell. Without success where that leaves a direction open.
  visual_frontend::PoseResult solveByDepth(const Correspondences& c, const Pose& predicted, double rotation_sigma,
                                           KeyframeId reference, const cv::Mat& depth) const;
  /// Why a pose found from so many landmarks cannot be; empty: it can.
  std::string objection(double stamp, const visual_frontend::PoseResult& pose, std::size_t landmarks) const;
  std::string tooFast(double stamp, const Pose& T_map_camera) const;  ///< likewise
  /// Searches the local map around a pose, refines it with what was found, and starts tracks there.
  void reobserve(const Pose& around, double radius, const cv::Mat& depth, visual_frontend::PoseResult* pose);
  /// Of the matches that agree with the pose; `first`: place of the first of them among its inliers.
  void startTracks(const std::vector<visual_frontend::LandmarkMatch>& matches, const visual_frontend::PoseResult& pose,
                   std::size_t first);
  Pose lastPose() const { return frames_.lastPose(map_); }

  CameraModel camera_;
  SlamSettings settings_;
  double focal_;  // [px]
  const visual_frontend::Map& map_;
  const Frames& frames_;
  visual_frontend::LandmarkTracks& tracks_;
  const KeyframeSurfaces& surfaces_;
  CameraMotion& motion_;
  visual_frontend::FeatureTracker tracker_;
  int since_reobservation_ = 0;  // [frames]
};

}  // namespace rgbd_slam
