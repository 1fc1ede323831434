// The keyframe whose view the present frames share, and when another must take its place.
#pragma once

#include "rgbd_slam/slam.h"
#include "visual_frontend/landmark_tracks.h"

namespace rgbd_slam {

class ReferenceKeyframe {
 public:
  explicit ReferenceKeyframe(const SlamSettings& settings) : settings_(settings) {}

  void reset() { *this = ReferenceKeyframe(settings_); }
  void set(const visual_frontend::Map& map, KeyframeId id);
  void countFrame() { ++frames_; }
  KeyframeId id() const { return id_; }

  /// A frame that sees so many landmarks needs another: its view has outgrown this one.
  bool due(const visual_frontend::Map& map, const Pose& T_map_camera, int landmarks) const;
  /// An earlier keyframe whose view such a frame has come back to; kNoKeyframe: none.
  KeyframeId ofView(const visual_frontend::Map& map, const visual_frontend::LandmarkTracks& tracks,
                    const Pose& T_map_camera, int landmarks) const;
  /// A keyframe that a view by depth alone goes by: the reference or, where the camera has left its view, the one that
  /// is nearest; kNoKeyframe: none is near enough.
  KeyframeId nearest(const visual_frontend::Map& map, const Pose& T_map_camera) const;
  /// It has fewer landmarks than a map needs to begin.
  bool hasFewLandmarks(const visual_frontend::Map& map) const;
  /// Two keyframes stand in the same place.
  bool same(const visual_frontend::Map& map, KeyframeId earlier, KeyframeId later) const;

 private:
  int patience() const;  ///< frames for which it lasts though landmarks are lost
  double changeOfView(const visual_frontend::Map& map, const visual_frontend::Keyframe& keyframe,
                      const Pose& T_map_camera) const;
  /// Whether a frame whose view differs from the keyframe's by `change` sees other things, by more than the settings
  /// allow.
  bool outgrown(const visual_frontend::Keyframe& keyframe, double change, int landmarks) const;

  SlamSettings settings_;
  KeyframeId id_ = visual_frontend::kNoKeyframe;
  int frames_ = 0;                       // since it became the reference
  int outgrown_here_ = 0;                // keyframes that soon were, about one place
  Pose T_map_place_ = Pose::Identity();  // that place
};

}  // namespace rgbd_slam
