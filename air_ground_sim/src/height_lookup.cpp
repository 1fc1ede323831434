#include "air_ground_sim/height_lookup.h"

#include <algorithm>
#include <cmath>

namespace air_ground_sim {

HeightLookup::HeightLookup(const air_ground_common::TriangleMesh& mesh) {
  const double half = 8.0;  // the robots stay well inside
  size_ = static_cast<int>(2 * half / kCell);
  origin_ = -half;
  cells_.assign(static_cast<std::size_t>(size_) * size_, 0.0f);
  const auto raise = [&](const Eigen::Vector3f& p) {
    const int x = static_cast<int>(std::floor((p.x() - origin_) / kCell)),
              y = static_cast<int>(std::floor((p.y() - origin_) / kCell));
    if (x < 0 || y < 0 || x >= size_ || y >= size_) return;
    float& cell = cells_[static_cast<std::size_t>(y) * size_ + x];
    cell = std::max(cell, p.z());
  };
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3f &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    if (std::max({std::abs(a.x()), std::abs(b.x()), std::abs(c.x())}) >= half - 0.5 ||
        std::max({std::abs(a.y()), std::abs(b.y()), std::abs(c.y())}) >= half - 0.5)
      continue;  // outer walls and the floor's rim do not concern the robots
    if (std::max({a.z(), b.z(), c.z()}) < 0.02f) continue;
    const int n = 1 + static_cast<int>(std::max((b - a).norm(), (c - a).norm()) / (0.5 * kCell));
    for (int i = 0; i <= n; ++i)
      for (int j = 0; i + j <= n; ++j)
        raise(a + (b - a) * (static_cast<float>(i) / n) + (c - a) * (static_cast<float>(j) / n));
  }
}

double HeightLookup::operator()(const Eigen::Vector2d& place, double radius) const {
  const int r = static_cast<int>(radius / kCell);
  const int cx = static_cast<int>((place.x() - origin_) / kCell), cy = static_cast<int>((place.y() - origin_) / kCell);
  float highest = 0;
  for (int y = std::max(0, cy - r); y <= std::min(size_ - 1, cy + r); ++y)
    for (int x = std::max(0, cx - r); x <= std::min(size_ - 1, cx + r); ++x)
      highest = std::max(highest, cells_[static_cast<std::size_t>(y) * size_ + x]);
  return highest;
}

}  // namespace air_ground_sim
