#include "columns.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace heightmap_mcl {
namespace {

constexpr float kGap = 0.5f;           // [m] nothing seen over that height ends a column
constexpr float kFace = 0.25f;         // [m] that much within a cell and its neighbours is a vertical face
constexpr float kWallAboveCap = 0.5f;  // [m] what is that high is a wall, though it was seen above the cap only
constexpr float kSameSurface = 0.1f;   // [m] a horizontal surface so near to a face's end is its top
constexpr double kTopReach = 0.06;     // [m] and lies so near to it
constexpr float kFlat = 0.12f;         // [m] what extends over more within a cell is no horizontal surface

struct Column {
  float base = kHole, top = kHole;  // of the piece that ends highest
  bool bound = false;
};

/// Walks up the points of a cell, sorted; `limit` is the height of the cap.
Column columnOf(const float* z, int count, float limit, const HeightMapSettings& settings) {
  Column column;
  int base = 0, end = 1;
  bool overhang = false;
  for (; end < count; ++end) {
    if (z[end] - z[end - 1] <= kGap) continue;
    if (z[end] > limit) break;
    base = end;
    overhang = true;
  }
  if (end < settings.min_points) return column;
  if (settings.drop_hanging && z[base] > limit && z[end - 1] - z[base] < kWallAboveCap) return column;
  const int rank = static_cast<int>(std::ceil(settings.height_quantile * end)) - 1;
  column.base = z[base];
  column.top = std::max(z[rank], z[base]);
  column.bound = overhang;
  if (column.top > limit) {
    column.top = limit;
    column.base = std::min(column.base, limit);
    column.bound = true;
  }
  return column;
}

/// Drops cells that stand out above every one of at least three defined neighbours.
void removeSpikes(HeightMap& map, double max_spike) {
  const HeightMap source = map;
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      if (std::isnan(source.at(r, c))) continue;
      float highest = -std::numeric_limits<float>::infinity();
      int neighbours = 0;
      for (int y = std::max(r - 1, 0); y <= std::min(r + 1, map.height - 1); ++y) {
        for (int x = std::max(c - 1, 0); x <= std::min(c + 1, map.width - 1); ++x) {
          if ((y == r && x == c) || std::isnan(source.at(y, x))) continue;
          highest = std::max(highest, source.at(y, x));
          ++neighbours;
        }
      }
      if (neighbours >= 3 && source.at(r, c) > highest + max_spike) map.at(r, c) = kHole;
    }
  }
}

/// Lowest base and highest top of a cell and its neighbours; NaN where there is none.
struct Pooled {
  std::vector<float> base, top;
};

Pooled pool(const HeightMap& map, const std::vector<float>& bases) {
  Pooled pooled{std::vector<float>(map.heights.size(), kHole), std::vector<float>(map.heights.size(), kHole)};
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      float low = kHole, high = kHole;
      for (int y = std::max(r - 1, 0); y <= std::min(r + 1, map.height - 1); ++y) {
        for (int x = std::max(c - 1, 0); x <= std::min(c + 1, map.width - 1); ++x) {
          const std::size_t k = static_cast<std::size_t>(y) * map.width + x;
          if (std::isnan(map.heights[k])) continue;
          if (!(bases[k] >= low)) low = bases[k];
          if (!(map.heights[k] <= high)) high = map.heights[k];
        }
      }
      const std::size_t k = static_cast<std::size_t>(r) * map.width + c;
      pooled.base[k] = low;
      pooled.top[k] = high;
    }
  }
  return pooled;
}

/// Marks faces that end without a horizontal surface beside their top.
std::vector<std::uint8_t> facesWithoutTop(const HeightMap& map, const Pooled& pooled) {
  std::vector<std::uint8_t> result(map.heights.size(), 0);
  const auto isFace = [&](std::size_t k) { return pooled.top[k] - pooled.base[k] > kFace; };
  const int reach = std::max(2, static_cast<int>(std::lround(kTopReach / map.resolution)));
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      const std::size_t k = static_cast<std::size_t>(r) * map.width + c;
      if (!isFace(k)) continue;
      bool topped = false;
      for (int y = std::max(r - reach, 0); y <= std::min(r + reach, map.height - 1) && !topped; ++y) {
        for (int x = std::max(c - reach, 0); x <= std::min(c + reach, map.width - 1) && !topped; ++x) {
          const std::size_t n = static_cast<std::size_t>(y) * map.width + x;
          topped = !std::isnan(map.heights[n]) && !isFace(n) && std::abs(pooled.top[n] - pooled.top[k]) < kSameSurface;
        }
      }
      result[k] = !topped;
    }
  }
  return result;
}

LevelHistogram histogramOf(const std::vector<float>& z, const std::vector<int>& begin) {
  LevelHistogram levels;
  if (z.empty()) return levels;
  const auto bin = [](float height) { return static_cast<long>(std::floor(height / kLevelBin)); };
  // Outliers far away in height must neither take memory nor hide the floor.
  std::vector<float> all = z;
  const auto low = all.begin() + static_cast<long>(all.size() / 1000);
  std::nth_element(all.begin(), low, all.end());
  levels.first = bin(*low);
  const long last = std::min(bin(*std::max_element(low, all.end())), levels.first + static_cast<long>(100 / kLevelBin));
  levels.cells.assign(static_cast<std::size_t>(last - levels.first + 1), 0.f);
  for (std::size_t k = 0; k + 1 < begin.size(); ++k) {
    long before = levels.first - 1;
    for (int i = begin[k], end; i < begin[k + 1]; i = end) {
      for (end = i + 1; end < begin[k + 1] && z[end] - z[end - 1] <= kFlat; ++end) continue;
      if (z[end - 1] - z[i] > kFlat) continue;  // a face
      for (int j = i; j < end; ++j) {
        const long b = bin(z[j]);
        if (b < levels.first || b > last || b == before) continue;
        ++levels.cells[b - levels.first];
        before = b;
      }
    }
  }
  return levels;
}

/// The paper's cells: highest point, or the quantile that the settings name; kClipped: not above the cap.
void fillHighest(std::vector<float>& z, const std::vector<int>& begin, const HeightMapSettings& settings,
                 HeightMap& map) {
  for (std::size_t k = 0; k < map.heights.size(); ++k) {
    const int count = begin[k + 1] - begin[k];
    if (count < settings.min_points) continue;
    const auto first = z.begin() + begin[k], last = z.begin() + begin[k + 1];
    const int rank = static_cast<int>(std::ceil(settings.height_quantile * count)) - 1;
    if (settings.tops == Tops::kHighest) std::nth_element(first, first + rank, last);
    map.heights[k] = *(first + rank);
    if (map.cap > 0) map.heights[k] = std::min(map.heights[k], static_cast<float>(map.floor + map.cap));
  }
}

}  // namespace

void LevelHistogram::add(const LevelHistogram& other) {
  if (other.cells.empty()) return;
  if (cells.empty()) {
    *this = other;
    return;
  }
  const long last =
      std::max(first + static_cast<long>(cells.size()), other.first + static_cast<long>(other.cells.size()));
  const long begin = std::min(first, other.first);
  // Maps that lie kilometres apart in height have no floor in common, and a level each between them would fill memory.
  if (static_cast<double>(last - begin) * kLevelBin > 2000) return;
  std::vector<float> sum(static_cast<std::size_t>(last - begin), 0.f);
  for (std::size_t i = 0; i < cells.size(); ++i) sum[first - begin + i] += cells[i];
  for (std::size_t i = 0; i < other.cells.size(); ++i) sum[other.first - begin + i] += other.cells[i];
  first = begin;
  cells = std::move(sum);
}

namespace {

constexpr int kSurfaceReach = 2;          // bins to either side: noise and tilt spread a floor over some 10 cm
constexpr float kShareOfLargest = 0.25f;  // of the largest surface; less is none

/// Cells within kSurfaceReach bins.
std::vector<float> areaByLevel(const LevelHistogram& levels) {
  const int n = static_cast<int>(levels.cells.size());
  std::vector<float> area(n, 0.f);
  for (int i = 0; i < n; ++i) {
    for (int j = std::max(i - kSurfaceReach, 0); j <= std::min(i + kSurfaceReach, n - 1); ++j)
      area[i] += levels.cells[j];
  }
  return area;
}

/// Mean height about a bin [m].
double levelAt(const LevelHistogram& levels, int peak) {
  const int n = static_cast<int>(levels.cells.size());
  double sum = 0, weight = 0;
  for (int j = std::max(peak - kSurfaceReach, 0); j <= std::min(peak + kSurfaceReach, n - 1); ++j) {
    sum += levels.cells[j] * (levels.first + j + 0.5) * kLevelBin;
    weight += levels.cells[j];
  }
  return sum / weight;
}

/// Heights of the large horizontal surfaces: peaks within 0.2 m.
std::vector<double> surfaces(const LevelHistogram& levels) {
  const std::vector<float> area = areaByLevel(levels);
  const int n = static_cast<int>(area.size()), reach = static_cast<int>(std::lround(0.1 / kLevelBin));
  std::vector<double> heights;
  if (n == 0) return heights;
  const float largest = *std::max_element(area.begin(), area.end());
  for (int i = 0; i < n; ++i) {
    const auto low = area.begin() + std::max(i - reach, 0), high = area.begin() + std::min(i + reach + 1, n);
    if (area[i] >= kShareOfLargest * largest && std::max_element(low, high) == area.begin() + i)
      heights.push_back(levelAt(levels, i));
  }
  return heights;
}

}  // namespace

double findFloor(const LevelHistogram& levels) {
  const std::vector<float> area = areaByLevel(levels);
  const int n = static_cast<int>(area.size());
  if (n == 0) return std::numeric_limits<double>::quiet_NaN();
  const float largest = *std::max_element(area.begin(), area.end());
  int peak = 0;
  while (area[peak] < kShareOfLargest * largest) ++peak;
  while (peak + 1 < n && area[peak + 1] > area[peak]) ++peak;
  return levelAt(levels, peak);
}

std::vector<double> floorCandidates(const LevelHistogram& air, const LevelHistogram& ground, double cap,
                                    std::size_t most) {
  constexpr double kApart = 0.1;       // [m]
  constexpr double kBelow = 0.02;      // share of the area that may lie below the floor
  constexpr float kLeastShare = 0.6f;  // of what the best supported place of the floor shares with the ground map
  std::vector<double> floors{findFloor(air)};
  const double ground_floor = findFloor(ground);
  if (std::isnan(floors[0]) || std::isnan(ground_floor)) return floors;
  // What the ground map has surfaces for, of the aerial map's area, and what lies below the floor.
  const std::vector<float> area = areaByLevel(air), ground_area = areaByLevel(ground);
  const float all = std::accumulate(area.begin(), area.end(), 0.f);
  struct Support {
    float shared = 0, below = 0;
  };
  const auto supportOf = [&](double floor) {
    Support support;
    const long shift = std::lround((ground_floor - floor) / kLevelBin) + air.first - ground.first;
    for (long i = 0; i < static_cast<long>(area.size()); ++i) {
      const long k = i + shift;
      if (k >= 0 && k < static_cast<long>(ground_area.size())) support.shared += std::min(area[i], ground_area[k]);
      if (static_cast<double>(air.first + i) * kLevelBin < floor - kApart) support.below += area[i];
    }
    return support;
  };
  std::vector<std::pair<float, double>> others;
  float most_shared = supportOf(floors[0]).shared;
  for (double a : surfaces(air)) {
    for (double g : surfaces(ground)) {
      const double floor = a - (g - ground_floor);
      if (g < ground_floor || g > ground_floor + cap || std::abs(floors[0] - floor) < kApart) continue;
      const Support support = supportOf(floor);
      if (support.below > kBelow * all) continue;
      others.emplace_back(support.shared, floor);
      most_shared = std::max(most_shared, support.shared);
    }
  }
  std::sort(others.rbegin(), others.rend());
  for (const auto& [shared, floor] : others) {
    const bool known =
        std::any_of(floors.begin(), floors.end(), [f = floor](double other) { return std::abs(other - f) < kApart; });
    if (!known && floors.size() < most && shared >= kLeastShare * most_shared) floors.push_back(floor);
  }
  return floors;
}

void fillCells(std::vector<float>& z, const std::vector<int>& begin, const HeightMapSettings& settings,
               const LevelHistogram* earlier, HeightMap& map) {
  if (settings.tops != Tops::kHighest) {
    for (std::size_t k = 0; k < map.heights.size(); ++k) std::sort(z.begin() + begin[k], z.begin() + begin[k + 1]);
    map.levels = histogramOf(z, begin);
    LevelHistogram all = map.levels;
    if (earlier) all.add(*earlier);
    map.floor = findFloor(all);
    map.cap = settings.cap;
  }
  if (settings.tops != Tops::kBounded) {
    fillHighest(z, begin, settings, map);
    if (settings.max_spike > 0) removeSpikes(map, settings.max_spike);
    map = dilate(map, settings.dilation);
    return;
  }
  const auto limit = static_cast<float>(map.floor + map.cap);
  map.bounds.assign(map.heights.size(), 0);
  std::vector<float> bases(map.heights.size(), kHole);
  for (std::size_t k = 0; k < map.heights.size(); ++k) {
    const int count = begin[k + 1] - begin[k];
    if (count < settings.min_points) continue;
    const Column column = columnOf(z.data() + begin[k], count, limit, settings);
    map.heights[k] = column.top;
    bases[k] = column.base;
    map.bounds[k] = column.bound;
  }
  if (settings.max_spike > 0) removeSpikes(map, settings.max_spike);
  const auto open = facesWithoutTop(map, pool(map, bases));
  map = dilate(map, settings.dilation);
  for (std::size_t k = 0; k < open.size(); ++k) {
    if (open[k] && !std::isnan(map.heights[k])) map.bounds[k] = 1;
  }
}

}  // namespace heightmap_mcl
