// When an image becomes a keyframe: it sees other things than the last one, or the inertial link would grow too long.
#pragma once

#include "mav_vo/odometry.h"

namespace mav_vo {

class KeyframePolicy {
 public:
  explicit KeyframePolicy(const OdometrySettings& settings) : settings_(settings) {}

  void reset() { *this = KeyframePolicy(settings_); }
  /// An image at `stamp` [s] that sees so many landmarks of the map, of a scene so far away.
  bool due(const visual_frontend::Keyframe& last, double stamp, const Pose& T_map_camera, double scene_distance,
           int landmarks) const;
  /// Before the image is made a keyframe.
  void follow(const visual_frontend::Keyframe& last, const Pose& T_map_camera, double scene_distance) {
    hovering_ = !moved(last, T_map_camera, scene_distance);
  }
  /// The new keyframe sees what the one before it saw.
  bool hovering() const { return hovering_; }
  void setLandmarks(int landmarks) { landmarks_ = landmarks; }  ///< that the new keyframe sees

 private:
  /// Enough to see anything new.
  bool moved(const visual_frontend::Keyframe& since, const Pose& T_map_camera, double scene_distance) const;

  OdometrySettings settings_;
  bool hovering_ = false;
  int landmarks_ = 0;
};

}  // namespace mav_vo
