#include "dense_fusion/point_map.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace dense_fusion {

PointMap::PointMap(double cell) : cell_(cell) {
  if (!(cell > 0)) throw std::invalid_argument("point map: the cell must be positive");
}

void PointMap::add(const std::vector<SurfacePoint>& points) {
  // 21 bits a coordinate: 20 km each way with cells of 2 cm.
  const auto field = [this](float v) {
    return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(v / cell_)) + (1 << 20)) & ((1u << 21) - 1);
  };
  for (const SurfacePoint& p : points) {
    const std::uint64_t key = field(p.position.z()) << 42 | field(p.position.y()) << 21 | field(p.position.x());
    const auto [it, inserted] = cells_.try_emplace(key, p);
    if (!inserted && p.support >= it->second.support) it->second = p;
  }
}

std::vector<SurfacePoint> PointMap::points() const {
  std::vector<std::uint64_t> keys;
  keys.reserve(cells_.size());
  for (const auto& [key, point] : cells_) keys.push_back(key);
  std::sort(keys.begin(), keys.end());
  std::vector<SurfacePoint> result;
  result.reserve(keys.size());
  for (const std::uint64_t key : keys) result.push_back(cells_.at(key));
  return result;
}

}  // namespace dense_fusion
