#include "icp_refine/ceilings.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "key_table.h"

namespace icp_refine {
namespace {

constexpr float kLevel = 0.94f, kSteep = 0.5f;  // z of normals: within 20 degrees of the vertical, beyond 60
constexpr float kAbove = 0.1f;                  // the camera, to be sure [m]
constexpr float kRoom = 1.5f;  // for a MAV; a slope of 20 degrees falls by a third of it from cell to cell [m]
constexpr float kColumn = 0.5f, kCube = 0.25f;  // [m]

/// Lowest point about a place.
class Depths {
 public:
  explicit Depths(const Cloud& cloud) {
    for (const auto& p : cloud.points) {
      const auto k = static_cast<std::size_t>(columns_.insert(column(p)));
      if (k == lowest_.size())
        lowest_.push_back(p.z());
      else
        lowest_[k] = std::min(lowest_[k], p.z());
    }
  }
  bool any(const Eigen::Vector3f& p, float below) const {
    for (int dx = -1; dx <= 1; ++dx)
      for (int dy = -1; dy <= 1; ++dy) {
        const int k =
            columns_.find(column(p + kColumn * Eigen::Vector3f(static_cast<float>(dx), static_cast<float>(dy), 0)));
        if (k >= 0 && lowest_[static_cast<std::size_t>(k)] < below) return true;
      }
    return false;
  }

 private:
  static std::uint64_t column(const Eigen::Vector3f& p) { return cellKey({p.x(), p.y(), 0}, kColumn); }

  KeyTable columns_;
  std::vector<float> lowest_;
};

/// Points above the camera. Noise tilts some normals: most of them tell.
struct Cube {
  Eigen::Vector3f point;
  int level = 0, all = 0;
  bool hangs = false, ceiling = false;
};

}  // namespace

std::vector<char> onCeilings(const Cloud& ground, double camera) {
  std::vector<char> mask(ground.size(), 0);
  if (!std::isfinite(camera) || !ground.hasNormals()) return mask;
  const Depths depths(ground);
  KeyTable keys;
  std::vector<Cube> cubes;
  std::vector<int> cube_of(ground.size(), -1), waiting;
  for (std::size_t i = 0; i < ground.size(); ++i) {
    const Eigen::Vector3f& p = ground.points[i];
    if (p.z() < camera + kAbove) continue;
    cube_of[i] = keys.insert(cellKey(p, kCube));
    if (static_cast<std::size_t>(cube_of[i]) == cubes.size()) cubes.push_back({p});
    Cube& cube = cubes[static_cast<std::size_t>(cube_of[i])];
    const bool level = std::abs(ground.normals[i].z()) > kLevel;
    ++cube.all;
    cube.level += level;
    cube.hangs = cube.hangs || (level && depths.any(p, p.z() - kRoom));
  }
  const auto take = [&](int k) {
    Cube& cube = cubes[static_cast<std::size_t>(k)];
    if (cube.ceiling || 2 * cube.level <= cube.all) return;
    cube.ceiling = true;
    waiting.push_back(k);
  };
  for (int k = 0; k < keys.size(); ++k)
    if (cubes[static_cast<std::size_t>(k)].hangs) take(k);
  // It goes on where nobody saw what is below.
  while (!waiting.empty()) {
    const Eigen::Vector3f p = cubes[static_cast<std::size_t>(waiting.back())].point;
    waiting.pop_back();
    for (int n = 0; n < 27; ++n) {
      const Eigen::Vector3i step(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
      if (const int k = keys.find(cellKey(p + kCube * step.cast<float>(), kCube)); k >= 0) take(k);
    }
  }
  for (std::size_t i = 0; i < ground.size(); ++i)
    mask[i] = cube_of[i] >= 0 && cubes[static_cast<std::size_t>(cube_of[i])].ceiling &&
              std::abs(ground.normals[i].z()) > kSteep;
  return mask;
}

std::vector<char> onUndersides(const std::vector<Eigen::Vector3f>& ground, const std::vector<float>& hidden_from) {
  constexpr float kCell = 0.05f, kHangs = 0.1f, kAbout = 0.08f;  // of columns; above the floor; the height told [m]
  if (ground.size() != hidden_from.size())
    throw std::invalid_argument("onUndersides: as many heights as points are needed");
  struct Range {
    float lowest, highest;  // of hidden_from
    float floor;            // highest point that has it
  };
  KeyTable columns;
  std::vector<Range> ranges;
  const auto column = [](const Eigen::Vector3f& p) { return cellKey({p.x(), p.y(), 0}, kCell); };
  for (std::size_t i = 0; i < ground.size(); ++i) {
    const float from = hidden_from[i];
    if (std::isnan(from)) continue;
    const auto k = static_cast<std::size_t>(columns.insert(column(ground[i])));
    if (k == ranges.size()) ranges.push_back({from, from, ground[i].z()});
    ranges[k] = {std::min(ranges[k].lowest, from), std::max(ranges[k].highest, from),
                 std::max(ranges[k].floor, ground[i].z())};
  }
  std::vector<char> mask(ground.size(), 0);
  if (ranges.empty()) return mask;
  for (std::size_t i = 0; i < ground.size(); ++i) {
    const Eigen::Vector3f& p = ground[i];
    for (int n = 0; n < 9 && !mask[i]; ++n) {
      const Eigen::Vector3f step(static_cast<float>(n % 3 - 1), static_cast<float>(n / 3 - 1), 0);
      const int k = columns.find(column(p + kCell * step));
      if (k < 0) continue;
      const Range& range = ranges[static_cast<std::size_t>(k)];
      mask[i] = p.z() > range.floor + kHangs && p.z() > range.lowest - kAbout && p.z() < range.highest + kAbout;
    }
  }
  return mask;
}

IcpReference referenceBelowCeilings(const IcpChain& chain, const Cloud& ground, double camera) {
  Cloud whole = chain.filteredReference(ground);
  const std::vector<char> ceiling = onCeilings(whole, camera);
  Cloud rest;  // without normals: faces were turned to where the map is lower, under a ceiling nowhere
  for (std::size_t i = 0; i < ceiling.size(); ++i)
    if (!ceiling[i]) rest.points.push_back(whole.points[i]);
  return rest.size() == ceiling.size() ? chain.searchable(std::move(whole)) : chain.prepareReference(std::move(rest));
}

}  // namespace icp_refine
