// Dense points of the keyframes; those of the newest are still refined by the frames that share its view.
#pragma once

#include <deque>
#include <map>
#include <memory>
#include <vector>

#include "gone_points.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

class DenseKeyframes {
 public:
  DenseKeyframes(const CameraModel& camera, const SlamSettings& settings)
      : camera_(camera), depth_(settings.depth), cloud_(settings.cloud), max_frames_(settings.max_fused_frames) {}

  void clear();
  /// A frame whose depth refines keyframes that begin soon. `stamp` [s].
  void remember(double stamp, const cv::Mat& depth, const Pose& T_map_camera,
                const visual_frontend::RollingShutter& rows);
  void forgetFrames() { recent_.clear(); }  ///< the map has moved
  /// A new keyframe, at T_map_camera, saw this.
  void begin(KeyframeId id, double stamp, const cv::Mat& depth, const cv::Mat& colour, const Pose& T_map_camera,
             const visual_frontend::RollingShutter& rows);
  /// Refines the newest keyframe, as long as it is not finished, which it is after some frames. T_frame_keyframe: from
  /// its camera to the frame's.
  void fuse(const cv::Mat& depth, const Pose& T_frame_keyframe, const visual_frontend::RollingShutter& rows);
  void finish();  ///< the frames' view is no longer the newest keyframe's
  void forget(KeyframeId id) {
    points_.erase(id);
    rays_.erase(id);
    gone_.erase(id);
  }
  /// A depth image that shares the view of a keyframe: what it and some before it see through goes out of that one's
  /// points. True: some did.
  bool lookThrough(KeyframeId id, const cv::Mat& depth, const Pose& T_frame_keyframe,
                   const visual_frontend::RollingShutter& rows);
  /// Moves the points of a finished keyframe to where the middle row sees them.
  void moveRows(KeyframeId id, const visual_frontend::RollingShutter& shift);
  /// Points of all keyframes, now finished, by a better calibration than the one they were made with.
  void recalibrate(const CameraModel& camera);
  std::vector<PosedPoints> posed(const visual_frontend::Map& map) const;

 private:
  std::shared_ptr<const DepthRays> raysOf(KeyframeId id) const;

  CameraModel camera_;
  DepthModel depth_;
  CloudSettings cloud_;
  int max_frames_;
  std::map<KeyframeId, KeyframePoints> points_;
  std::map<KeyframeId, std::shared_ptr<const DepthRays>> rays_;
  std::map<KeyframeId, GonePoints> gone_;  // of those that were looked through
  struct Recent {
    double stamp;
    cv::Mat depth;
    Pose T_map_camera;
    visual_frontend::RollingShutter rows;
  };
  std::deque<Recent> recent_;
  std::unique_ptr<KeyframeDepth> active_;
  int frames_before_ = 0;  // that it was refined by when it began
  KeyframeId active_id_ = visual_frontend::kNoKeyframe;
};

}  // namespace rgbd_slam
