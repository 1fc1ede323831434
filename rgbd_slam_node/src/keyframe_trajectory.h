// Where the camera was, each frame by a keyframe, so that it moves with the map when that is corrected.
#pragma once

#include <optional>
#include <vector>

#include "air_ground_common/trajectory.h"
#include "visual_frontend/map.h"
#include "visual_frontend/rolling_shutter.h"

namespace rgbd_slam {

class KeyframeTrajectory {
 public:
  void add(double stamp, const air_ground_common::Pose& T_map_camera, visual_frontend::KeyframeId reference,
           const visual_frontend::Map& map);
  bool empty() const { return frames_.empty(); }
  double lastStamp() const { return frames_.back().stamp; }
  /// Camera of the last frame in the map, as its keyframe stands now.
  air_ground_common::Pose lastPose(const visual_frontend::Map& map) const;
  air_ground_common::Trajectory poses(const visual_frontend::Map& map) const;
  /// How the camera moved at the frame of this stamp, by those before and after it.
  std::optional<visual_frontend::CameraVelocity> velocityAt(double stamp, const visual_frontend::Map& map) const;
  /// Before keyframe `from` leaves the map: its frames go by `to`.
  void rebase(visual_frontend::KeyframeId from, visual_frontend::KeyframeId to, const visual_frontend::Map& map);
  void clear() { frames_.clear(); }

 private:
  /// 40 bytes a frame, for they stay as long as the map: a micrometre or microradian is lost.
  struct Frame {
    double stamp;  ///< [s]
    visual_frontend::KeyframeId reference;
    float translation[3], rotation[4];  ///< T_reference_camera; quaternion x y z w
    void set(const air_ground_common::Pose& T_reference_camera);
    air_ground_common::Pose pose() const;
  };
  std::vector<Frame> frames_;
  air_ground_common::Pose T_reference_last_ = air_ground_common::Pose::Identity();  ///< of the last one, whole
};

}  // namespace rgbd_slam
