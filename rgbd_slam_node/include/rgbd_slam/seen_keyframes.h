// The keyframes whose rays a map of space is made of.
#pragma once

#include <memory>
#include <unordered_map>
#include <vector>

#include "air_ground_common/geometry.h"
#include "rgbd_slam/ground_cloud.h"

namespace rgbd_slam {

class SeenKeyframes {
 public:
  /// `cast(T_map_camera, rays, sign)` for each keyframe that is new (1), missing (-1), or has moved by some centimetres
  /// or has other rays (-1 as it was, then 1). Where more would be taken out than is left, `clear()` instead, and all
  /// are new.
  template <typename Clear, typename Cast>
  void update(const std::vector<PosedPoints>& keyframes, const Clear& clear, const Cast& cast) {
    const std::vector<Seen> changed = takeChanged(keyframes);
    if (changed.size() > seen_.size()) {
      seen_.clear();
      clear();
    } else {
      for (const Seen& k : changed) cast(k.T_map_camera, *k.rays, -1);
    }
    for (const PosedPoints& k : keyframes)
      if (k.rays && seen_.emplace(k.keyframe, Seen{k.T_map_camera, k.rays}).second) cast(k.T_map_camera, *k.rays, 1);
  }
  void clear() { seen_.clear(); }

 private:
  struct Seen {
    air_ground_common::Pose T_map_camera;
    std::shared_ptr<const DepthRays> rays;
  };
  /// Forgets those that are not where they were; returns them.
  std::vector<Seen> takeChanged(const std::vector<PosedPoints>& keyframes);

  std::unordered_map<int, Seen> seen_;  // by number
};

}  // namespace rgbd_slam
