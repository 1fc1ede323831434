#include "dense_fusion/point_map.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace dense_fusion {

PointMap::PointMap(double cell, std::size_t max_points) : first_cell_(cell), cell_(cell), max_points_(max_points) {
  if (!(cell > 0)) throw std::invalid_argument("point map: the cell must be positive");
  if (max_points < 8) throw std::invalid_argument("point map: max_points must be at least 8");
}

bool PointMap::insert(const SurfacePoint& point) {
  // 21 bits a coordinate: 20 km each way with cells of 2 cm.
  constexpr int kHalf = 1 << 20;
  std::uint64_t key = 0;
  for (const float v : {point.position.z(), point.position.y(), point.position.x()}) {
    const double index = std::floor(v / cell_);
    if (!(index >= -kHalf && index < kHalf)) return false;  // NaN, too
    key = key << 21 | static_cast<std::uint64_t>(static_cast<std::int64_t>(index) + kHalf);
  }
  const auto [it, inserted] = cells_.try_emplace(key, point);
  if (!inserted && point.support >= it->second.support) it->second = point;
  return true;
}

std::size_t PointMap::add(const std::vector<SurfacePoint>& points) {
  std::size_t left_out = 0;
  for (const SurfacePoint& p : points) {
    left_out += !insert(p);
    while (cells_.size() > max_points_) {
      const std::vector<SurfacePoint> kept = this->points();
      cells_.clear();
      cell_ *= 2;
      for (const SurfacePoint& k : kept) insert(k);
    }
  }
  return left_out;
}

void PointMap::clear() {
  cells_.clear();
  cell_ = first_cell_;
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
