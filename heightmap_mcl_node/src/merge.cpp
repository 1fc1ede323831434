// Union of height maps.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "heightmap_mcl/height_map.h"

namespace heightmap_mcl {
namespace {

/// A bound that much above a cell's height contradicts it [m].
constexpr float kContradiction = 0.2f;

struct Extent {
  long c0 = std::numeric_limits<long>::max(), r0 = c0, c1 = std::numeric_limits<long>::min(), r1 = c1;
};
long column0(const HeightMap& m) { return std::lround(m.origin_x / m.resolution); }
long row0(const HeightMap& m) { return std::lround(m.origin_y / m.resolution); }

/// Cells from (r0, c0) to before (r1, c1) that the grids cover.
Extent extentOf(const std::vector<const HeightMap*>& maps) {
  Extent e;
  for (const HeightMap* m : maps) {
    if (m->empty()) continue;
    e.c0 = std::min(e.c0, column0(*m));
    e.r0 = std::min(e.r0, row0(*m));
    e.c1 = std::max(e.c1, column0(*m) + m->width);
    e.r1 = std::max(e.r1, row0(*m) + m->height);
  }
  return e;
}

/// Sums of one cell over the maps.
struct Cell {
  float height = kHole, bound = kHole;
  int heights = 0;

  void add(float h, bool is_bound, Merge mode) {
    if (is_bound) {
      if (!(h <= bound)) bound = h;
    } else if (mode == Merge::kHighest) {
      if (!(h <= height)) height = h;
    } else {
      const int n = heights++;
      height = n == 0 ? h : height + (h - height) / static_cast<float>(n + 1);
    }
  }
  bool isBound() const { return !std::isnan(bound) && !(bound <= height + kContradiction); }
};

}  // namespace

double unionExtent(const std::vector<const HeightMap*>& maps) {
  const Extent e = extentOf(maps);
  for (const HeightMap* m : maps) {
    if (!m->empty()) return static_cast<double>(std::max(e.c1 - e.c0, e.r1 - e.r0)) * m->resolution;
  }
  return 0;
}

HeightMap merge(const std::vector<const HeightMap*>& maps, Merge mode) {
  HeightMap result;
  bool any = false, bounded = false;
  for (const HeightMap* m : maps) {
    if (m->empty()) continue;
    if (any && m->resolution != result.resolution)
      throw std::invalid_argument("merge: height maps of different resolution");
    result.resolution = m->resolution;
    result.cap = std::max(result.cap, m->cap);
    result.levels.add(m->levels);
    bounded = bounded || !m->bounds.empty();
    any = true;
  }
  if (!any) return result;
  result.floor = findFloor(result.levels);
  const auto [c0, r0, c1, r1] = extentOf(maps);
  result.width = static_cast<int>(c1 - c0);
  result.height = static_cast<int>(r1 - r0);
  result.origin_x = c0 * result.resolution;
  result.origin_y = r0 * result.resolution;
  std::vector<Cell> cells(static_cast<std::size_t>(result.width) * result.height);
  for (const HeightMap* m : maps) {
    if (m->empty()) continue;
    const long dc = column0(*m) - c0, dr = row0(*m) - r0;
    for (int r = 0; r < m->height; ++r) {
      for (int c = 0; c < m->width; ++c) {
        const float h = m->at(r, c);
        if (std::isnan(h)) continue;
        cells[static_cast<std::size_t>(r + dr) * result.width + (c + dc)].add(
            h, m->isBound(static_cast<std::size_t>(r) * m->width + c), mode);
      }
    }
  }
  result.heights.resize(cells.size());
  if (bounded) result.bounds.resize(cells.size());
  for (std::size_t k = 0; k < cells.size(); ++k) {
    result.heights[k] = cells[k].isBound() ? cells[k].bound : cells[k].height;
    if (bounded) result.bounds[k] = cells[k].isBound();
  }
  // The floor of all may lie lower than that of the map that a height was capped in.
  const double floor = result.floor;
  return withFloor(std::move(result), floor);
}

HeightMap withFloor(HeightMap map, double floor) {
  map.floor = floor;
  if (std::isnan(floor) || map.cap <= 0) return map;
  const auto limit = static_cast<float>(floor + map.cap);
  for (std::size_t k = 0; k < map.heights.size(); ++k) {
    if (!(map.heights[k] > limit)) continue;
    map.heights[k] = limit;
    if (!map.bounds.empty()) map.bounds[k] = 1;
  }
  return map;
}

}  // namespace heightmap_mcl
