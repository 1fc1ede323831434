// Where the camera was, each frame by a keyframe, so that it moves with the map when that is corrected.
#pragma once

#include <map>
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

/// Frames between two keyframes follow both, in proportion to time: what an adjustment moves one of them by against the
/// other is no leap of the trajectory, and a change of scale between them no error of those half-way.
/// `StoredPose`: Pose, or CompactPose where frames stay as long as the map; the last one is kept whole all the same.
template <class StoredPose>
class KeyframeTrajectory {
 public:
  /// Stamps go up. Throws std::out_of_range where `reference` is not in the map, as all that take one do.
  void add(double stamp, const Pose& T_map_camera, KeyframeId reference, const Map& map);
  /// The last frame became this keyframe, or is the image of the one that it goes by, however it was placed.
  void lastIsKeyframe(KeyframeId id);
  void clear();

  bool empty() const { return frames_.empty(); }
  std::size_t size() const { return frames_.size(); }
  double stamp(std::size_t i) const { return frames_[i].stamp; }              ///< [s]
  double lastStamp() const { return frames_.back().stamp; }                   ///< [s]
  KeyframeId reference(std::size_t i) const { return frames_[i].reference; }  ///< keyframe that places the frame
  KeyframeId lastReference() const { return frames_.back().reference; }
  bool isKeyframe(std::size_t i) const;  ///< the frame is where its keyframe is
  /// T_map_camera, as the keyframes around it stand now.
  Pose pose(std::size_t i, const Map& map) const;
  Pose lastPose(const Map& map) const { return map.keyframe(lastReference()).T_map_camera * T_reference_last_; }
  air_ground_common::Trajectory poses(const Map& map) const;
  /// How the camera moved at the frame of this stamp, by those before and after it.
  std::optional<CameraVelocity> velocityAt(double stamp, const Map& map) const;

  /// Before keyframe `from` leaves the map: its frames, and those that follow it and another, go by one alone.
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
  /// How the next keyframe stood in one, when the last of the frames between them was placed.
  struct Link {
    KeyframeId next;
    double begin, end;  ///< stamps between which frames go by both [s]
    Pose T_this_next;
  };
  void link(KeyframeId next, const Pose& T_reference_next);
  const Link* linkOf(const Frame& frame) const;

  std::vector<Frame> frames_;
  std::map<KeyframeId, Link> links_;
  double run_begin_ = 0;                     ///< since when frames go by the last one's reference [s]
  Pose T_reference_run_ = Pose::Identity();  ///< where its own image was placed, and those after it with the same error
  Pose T_reference_last_ = Pose::Identity();
};

extern template class KeyframeTrajectory<Pose>;
extern template class KeyframeTrajectory<CompactPose>;

}  // namespace visual_frontend
