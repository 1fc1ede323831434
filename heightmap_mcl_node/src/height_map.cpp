#include "heightmap_mcl/height_map.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>

namespace heightmap_mcl {
namespace {

constexpr float kFarthest = 1e6f;  // [m] beyond it a float cannot tell cells apart

/// Keeps the points of the square of edge `extent` that holds most of them, to a tenth of its edge.
void keepDensestRegion(std::vector<Eigen::Vector3f>& points, double extent) {
  constexpr long kReach = 5;  // a window is 11 x 11 bins
  const double edge = extent / (2 * kReach + 1);
  using Bin = std::pair<long, long>;
  const auto binOf = [edge](const Eigen::Vector3f& p) {
    return Bin(static_cast<long>(std::floor(p.x() / edge)), static_cast<long>(std::floor(p.y() / edge)));
  };
  std::map<Bin, std::size_t> bins;
  for (const auto& p : points) ++bins[binOf(p)];
  Bin best;
  std::size_t most = 0;
  for (const auto& [bin, count] : bins) {
    std::size_t sum = 0;
    for (long x = bin.first - kReach; x <= bin.first + kReach; ++x) {
      for (auto it = bins.lower_bound({x, bin.second - kReach});
           it != bins.end() && it->first <= Bin(x, bin.second + kReach); ++it) {
        sum += it->second;
      }
    }
    if (sum > most) {
      most = sum;
      best = bin;
    }
  }
  const auto outside = [&](const Eigen::Vector3f& p) {
    const Bin bin = binOf(p);
    return std::labs(bin.first - best.first) > kReach || std::labs(bin.second - best.second) > kReach;
  };
  points.erase(std::remove_if(points.begin(), points.end(), outside), points.end());
}

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

}  // namespace

std::size_t HeightMap::defined() const {
  return static_cast<std::size_t>(
      std::count_if(heights.begin(), heights.end(), [](float h) { return !std::isnan(h); }));
}

void validate(const HeightMapSettings& settings) {
  const auto require = [](bool ok, const std::string& text) {
    if (!ok) throw std::invalid_argument("height map settings: " + text);
  };
  require(settings.resolution > 0 && std::isfinite(settings.resolution), "resolution must be positive [m]");
  require(settings.height_quantile > 0 && settings.height_quantile <= 1, "height_quantile must be in (0, 1]");
  require(settings.min_points >= 1, "min_points must be at least 1");
  require(settings.max_spike >= 0, "max_spike must not be negative [m]");
  require(settings.max_extent >= 10 * settings.resolution && settings.max_extent / settings.resolution <= 20000,
          "max_extent must be 10 to 20000 cells [m]");
}

HeightMap buildHeightMap(const std::vector<Eigen::Vector3f>& points, const HeightMapSettings& settings,
                         std::size_t* cropped) {
  validate(settings);
  if (cropped) *cropped = 0;
  std::vector<Eigen::Vector3f> valid;
  valid.reserve(points.size());
  for (const auto& p : points) {
    if (p.allFinite() && p.head<2>().cwiseAbs().maxCoeff() <= kFarthest) valid.push_back(p);
  }
  HeightMap map;
  map.resolution = settings.resolution;
  if (valid.empty()) return map;

  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  const auto extend = [&](const Eigen::Vector3f& p) {
    low = low.cwiseMin(p.head<2>().cast<double>());
    high = high.cwiseMax(p.head<2>().cast<double>());
  };
  for (const auto& p : valid) extend(p);
  if ((high - low).maxCoeff() > settings.max_extent) {
    // Far outliers must not blow up the grid.
    const std::size_t before = valid.size();
    keepDensestRegion(valid, settings.max_extent);
    if (cropped) *cropped = before - valid.size();
    low.setConstant(std::numeric_limits<double>::infinity());
    high = -low;
    for (const auto& p : valid) extend(p);
  }
  // One empty cell around, so that the dilation grows outwards too.
  const double res = settings.resolution;
  const long c0 = static_cast<long>(std::floor(low.x() / res)) - 1,
             c1 = static_cast<long>(std::floor(high.x() / res)) + 1;
  const long r0 = static_cast<long>(std::floor(low.y() / res)) - 1,
             r1 = static_cast<long>(std::floor(high.y() / res)) + 1;
  map.width = static_cast<int>(c1 - c0 + 1);
  map.height = static_cast<int>(r1 - r0 + 1);
  map.origin_x = c0 * res;
  map.origin_y = r0 * res;
  map.heights.assign(static_cast<std::size_t>(map.width) * map.height, kHole);

  std::vector<int> cell_of(valid.size());
  std::vector<int> begin(map.heights.size() + 1, 0);
  for (std::size_t i = 0; i < valid.size(); ++i) {
    const long c = static_cast<long>(std::floor(valid[i].x() / res)) - c0;
    const long r = static_cast<long>(std::floor(valid[i].y() / res)) - r0;
    cell_of[i] = static_cast<int>(r * map.width + c);
    ++begin[cell_of[i] + 1];
  }
  for (std::size_t k = 1; k < begin.size(); ++k) begin[k] += begin[k - 1];
  std::vector<float> sorted(valid.size());
  std::vector<int> next(begin.begin(), begin.end() - 1);
  for (std::size_t i = 0; i < valid.size(); ++i) sorted[next[cell_of[i]]++] = valid[i].z();
  for (std::size_t k = 0; k < map.heights.size(); ++k) {
    const int count = begin[k + 1] - begin[k];
    if (count < settings.min_points) continue;
    const auto first = sorted.begin() + begin[k], last = sorted.begin() + begin[k + 1];
    const int rank = static_cast<int>(std::ceil(settings.height_quantile * count)) - 1;
    std::nth_element(first, first + rank, last);
    map.heights[k] = *(first + rank);
  }
  if (settings.max_spike > 0) removeSpikes(map, settings.max_spike);
  if (map.defined() == 0) {
    HeightMap none;
    none.resolution = settings.resolution;
    return none;
  }
  return dilate(map, settings.dilation);
}

HeightMap dilate(const HeightMap& map, Dilation mode) {
  if (mode == Dilation::kNone || map.empty()) return map;
  HeightMap result = map;
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      if (mode == Dilation::kHoles && !std::isnan(map.at(r, c))) continue;
      float highest = kHole;
      for (int y = std::max(r - 1, 0); y <= std::min(r + 1, map.height - 1); ++y) {
        for (int x = std::max(c - 1, 0); x <= std::min(c + 1, map.width - 1); ++x) {
          const float h = map.at(y, x);
          if (!std::isnan(h) && !(h <= highest)) highest = h;
        }
      }
      result.at(r, c) = highest;
    }
  }
  return result;
}

double unionExtent(const std::vector<const HeightMap*>& maps) {
  const Extent e = extentOf(maps);
  for (const HeightMap* m : maps) {
    if (!m->empty()) return static_cast<double>(std::max(e.c1 - e.c0, e.r1 - e.r0)) * m->resolution;
  }
  return 0;
}

HeightMap merge(const std::vector<const HeightMap*>& maps, Merge mode) {
  HeightMap result;
  bool any = false;
  for (const HeightMap* m : maps) {
    if (m->empty()) continue;
    if (any && m->resolution != result.resolution)
      throw std::invalid_argument("merge: height maps of different resolution");
    result.resolution = m->resolution;
    any = true;
  }
  if (!any) return result;
  const auto [c0, r0, c1, r1] = extentOf(maps);
  result.width = static_cast<int>(c1 - c0);
  result.height = static_cast<int>(r1 - r0);
  result.origin_x = c0 * result.resolution;
  result.origin_y = r0 * result.resolution;
  result.heights.assign(static_cast<std::size_t>(result.width) * result.height, kHole);
  std::vector<int> count(mode == Merge::kMean ? result.heights.size() : 0, 0);
  for (const HeightMap* m : maps) {
    if (m->empty()) continue;
    const long dc = column0(*m) - c0, dr = row0(*m) - r0;
    for (int r = 0; r < m->height; ++r) {
      for (int c = 0; c < m->width; ++c) {
        const float h = m->at(r, c);
        if (std::isnan(h)) continue;
        const std::size_t k = static_cast<std::size_t>(r + dr) * result.width + (c + dc);
        float& cell = result.heights[k];
        if (mode == Merge::kHighest) {
          if (!(h <= cell)) cell = h;
        } else {
          const int n = count[k]++;
          cell = n == 0 ? h : cell + (h - cell) / static_cast<float>(n + 1);
        }
      }
    }
  }
  return result;
}

HeightMap downsample(const HeightMap& map, int factor) {
  if (factor < 1) throw std::invalid_argument("downsample: factor must be at least 1");
  if (factor == 1 || map.empty()) return map;
  const long c0 = std::lround(map.origin_x / map.resolution), r0 = std::lround(map.origin_y / map.resolution);
  const auto floorDiv = [factor](long v) { return v >= 0 ? v / factor : -((-v + factor - 1) / factor); };
  HeightMap result;
  result.resolution = map.resolution * factor;
  const long C0 = floorDiv(c0), R0 = floorDiv(r0);
  result.width = static_cast<int>(floorDiv(c0 + map.width - 1) - C0 + 1);
  result.height = static_cast<int>(floorDiv(r0 + map.height - 1) - R0 + 1);
  result.origin_x = C0 * result.resolution;
  result.origin_y = R0 * result.resolution;
  result.heights.assign(static_cast<std::size_t>(result.width) * result.height, kHole);
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      const float h = map.at(r, c);
      float& cell = result.at(static_cast<int>(floorDiv(r0 + r) - R0), static_cast<int>(floorDiv(c0 + c) - C0));
      if (!std::isnan(h) && !(h <= cell)) cell = h;
    }
  }
  return result;
}

HeightMap rotateAbout(const HeightMap& map, const Eigen::Vector2d& pivot, double yaw, int cells) {
  if (cells < 2 || cells % 2 != 0) throw std::invalid_argument("rotateAbout: cells must be positive and even");
  HeightMap result;
  result.resolution = map.resolution;
  result.width = result.height = cells;
  result.origin_x = result.origin_y = -0.5 * cells * map.resolution;
  result.heights.assign(static_cast<std::size_t>(cells) * cells, kHole);
  const double c = std::cos(yaw), s = std::sin(yaw);
  // Source cell of a target cell: p = pivot + R(-yaw) q.
  const double base_x = (pivot.x() - map.origin_x) / map.resolution,
               base_y = (pivot.y() - map.origin_y) / map.resolution;
  for (int row = 0; row < cells; ++row) {
    const double qy = row + 0.5 - 0.5 * cells;
    for (int column = 0; column < cells; ++column) {
      const double qx = column + 0.5 - 0.5 * cells;
      const double x = base_x + c * qx + s * qy, y = base_y - s * qx + c * qy;
      if (x < 0 || y < 0 || x >= map.width || y >= map.height) continue;
      result.at(row, column) = map.at(static_cast<int>(y), static_cast<int>(x));
    }
  }
  return result;
}

double heightDeviation(const HeightMap& map) {
  double sum = 0, squares = 0;
  std::size_t n = 0;
  for (float h : map.heights) {
    if (std::isnan(h)) continue;
    sum += h;
    squares += static_cast<double>(h) * h;
    ++n;
  }
  if (n < 2) return 0;
  return std::sqrt(std::max(0.0, squares / n - (sum / n) * (sum / n)));
}

}  // namespace heightmap_mcl
