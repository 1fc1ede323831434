#include "rgbd_slam/seen_keyframes.h"

#include <algorithm>

#include "displacement.h"

namespace rgbd_slam {

std::size_t SeenKeyframes::stand(const std::vector<PosedPoints>& keyframes) const {
  constexpr double kRange = 4, kMoved = 0.025;  // of what a keyframe sees so far away [m]
  return static_cast<std::size_t>(std::count_if(keyframes.begin(), keyframes.end(), [this](const PosedPoints& k) {
    const auto it = seen_.find(k.keyframe);
    return it != seen_.end() && it->second.rays == k.rays &&
           displacement(it->second.T_map_camera, k.T_map_camera, kRange) <= kMoved;
  }));
}

}  // namespace rgbd_slam
