// What stood before the camera and went (persons, doors, chairs): later depth images see through it, or, where nothing
// is near enough beyond it to give a depth, see nothing where it gave one.
#pragma once

#include <cstdint>
#include <vector>

#include "rgbd_slam/ground_cloud.h"

namespace rgbd_slam {

/// For the points of one keyframe, by how many depth images in turn each has been seen through. An image that sees
/// nothing where the point should be, from about where the keyframe saw it, counts half. Not thread-safe.
class GonePoints {
 public:
  /// Another depth image, CV_32F [m], NaN or <= 0 = unknown. `T_frame_keyframe`: from the keyframe's camera to the
  /// frame's. `points`: the keyframe's, the same at each look.
  void look(const air_ground_common::CameraModel& camera, const std::vector<KeyframeDepth::Point>& points,
            const cv::Mat& depth, const air_ground_common::Pose& T_frame_keyframe, const DepthModel& model,
            const CloudSettings& settings, const visual_frontend::RollingShutter& rows);
  /// What is left of the points, once so many are gone that it is worth fusing the keyframe anew; null: not yet.
  KeyframePoints left(const std::vector<KeyframeDepth::Point>& points);

 private:
  std::vector<std::uint8_t> seen_through_;  // one a point [half images]
  std::size_t gone_ = 0;                    // points
};

}  // namespace rgbd_slam
