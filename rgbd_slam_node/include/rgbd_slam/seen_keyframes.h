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
  /// `add(T_map_camera, rays)` for each keyframe that is new; where one has moved by some centimetres, has other rays
  /// or is missing, `clear()` before, and all are new.
  template <typename Clear, typename Add>
  void update(const std::vector<PosedPoints>& keyframes, const Clear& clear, const Add& add) {
    if (stand(keyframes) < seen_.size()) {
      seen_.clear();
      clear();
    }
    for (const PosedPoints& k : keyframes) {
      if (k.rays && seen_.emplace(k.keyframe, Seen{k.T_map_camera, k.rays}).second) add(k.T_map_camera, *k.rays);
    }
  }
  void clear() { seen_.clear(); }

 private:
  struct Seen {
    air_ground_common::Pose T_map_camera;
    std::shared_ptr<const DepthRays> rays;
  };
  /// How many of those that were seen are where they were.
  std::size_t stand(const std::vector<PosedPoints>& keyframes) const;

  std::unordered_map<int, Seen> seen_;  // by number
};

}  // namespace rgbd_slam
