#include "rgbd_slam/seen_keyframes.h"

#include <unordered_set>
#include <utility>

#include "displacement.h"

namespace rgbd_slam {

std::vector<SeenKeyframes::Seen> SeenKeyframes::takeChanged(const std::vector<PosedPoints>& keyframes) {
  constexpr double kRange = 4, kMoved = 0.025;  // of what a keyframe sees so far away [m]
  std::unordered_set<int> stand;
  for (const PosedPoints& k : keyframes) {
    const auto it = seen_.find(k.keyframe);
    if (it != seen_.end() && it->second.rays == k.rays &&
        displacement(it->second.T_map_camera, k.T_map_camera, kRange) <= kMoved)
      stand.insert(k.keyframe);
  }
  std::vector<Seen> changed;
  for (auto it = seen_.begin(); it != seen_.end();) {
    if (stand.count(it->first)) {
      ++it;
      continue;
    }
    changed.push_back(std::move(it->second));
    it = seen_.erase(it);
  }
  return changed;
}

}  // namespace rgbd_slam
