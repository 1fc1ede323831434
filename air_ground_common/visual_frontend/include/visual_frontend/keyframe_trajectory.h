// Where the camera was, each frame by a keyframe, so that it moves with the map when that is corrected.
#pragma once

#include <optional>
#include <vector>

#include "air_ground_common/trajectory.h"
#include "visual_frontend/map.h"
#include "visual_frontend/rolling_shutter.h"

namespace visual_frontend {

/// A pose in 28 bytes: a micrometre or microradian is lost.
class CompactPose {
 public:
  CompactPose(const Pose& T);
  operator Pose() const;

 private:
  float translation_[3], rotation_[4];  // quaternion x y z w
};

/// `StoredPose`: Pose, or CompactPose where frames stay as long as the map; the last one is kept whole all the same.
template <class StoredPose>
class KeyframeTrajectory {
 public:
  /// Throws std::out_of_range where `reference` is not in the map, as all that take one do.
  void add(double stamp, const Pose& T_map_camera, KeyframeId reference, const Map& map);
  /// The last frame became this keyframe.
  void lastIsKeyframe(KeyframeId id);
  void clear() { frames_.clear(); }

  bool empty() const { return frames_.empty(); }
  std::size_t size() const { return frames_.size(); }
  double stamp(std::size_t i) const { return frames_[i].stamp; }              ///< [s]
  double lastStamp() const { return frames_.back().stamp; }                   ///< [s]
  KeyframeId reference(std::size_t i) const { return frames_[i].reference; }  ///< keyframe that places the frame
  KeyframeId lastReference() const { return frames_.back().reference; }
  bool isKeyframe(std::size_t i) const;  ///< the frame is where its keyframe is
  /// T_map_camera, as the frame's keyframe stands now.
  Pose pose(std::size_t i, const Map& map) const;
  Pose lastPose(const Map& map) const { return map.keyframe(lastReference()).T_map_camera * T_reference_last_; }
  air_ground_common::Trajectory poses(const Map& map) const;
  /// How the camera moved at the frame of this stamp, by those before and after it.
  std::optional<CameraVelocity> velocityAt(double stamp, const Map& map) const;

  /// Before keyframe `from` leaves the map: its frames go by `to`.
  void rebase(KeyframeId from, KeyframeId to, const Map& map);
  /// With Map::transform: `scale` is that of the similarity.
  void rescale(double scale);
  /// Bounds the memory: of more than `most` frames every second of the older half goes.
  void thin(std::size_t most);

 private:
  struct Frame {
    double stamp;  // [s]
    KeyframeId reference;
    StoredPose T_reference_camera;
  };
  std::vector<Frame> frames_;
  Pose T_reference_last_ = Pose::Identity();
};

extern template class KeyframeTrajectory<Pose>;
extern template class KeyframeTrajectory<CompactPose>;

}  // namespace visual_frontend
