#include "map_revision.h"

#include <cmath>

namespace mav_vo {

void MapRevision::follow(const visual_frontend::Map& map, double scene_distance) {
  std::map<visual_frontend::KeyframeId, Eigen::Vector3d> now, then;
  double squares = 0;
  int known = 0;
  const auto& keyframes = map.keyframes();
  for (auto it = keyframes.rbegin(); it != keyframes.rend() && static_cast<int>(now.size()) < kNewest; ++it) {
    const Eigen::Vector3d p = it->second.T_map_camera.translation();
    const auto before = positions_.find(it->first);
    now.emplace(it->first, p);
    then.emplace(it->first, before == positions_.end() ? p : before->second);
    if (before == positions_.end()) continue;
    squares += (p - before->second).squaredNorm();
    ++known;
  }
  const bool moved = known > 0 && std::sqrt(squares / known) > kMoved * scene_distance;
  corrections_ += moved;
  positions_ = std::move(moved ? now : then);
}

}  // namespace mav_vo
