#include "heightmap_mcl/height_map.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <utility>

#include "columns.h"

namespace heightmap_mcl {
namespace {

constexpr float kFarthest = 1e6f;  // [m] beyond it a float cannot tell cells apart

using Bin = std::pair<long, long>;

Bin binOf(const Eigen::Vector3f& p, double edge) {
  return {static_cast<long>(std::floor(p.x() / edge)), static_cast<long>(std::floor(p.y() / edge))};
}

struct BinHash {
  std::size_t operator()(const Bin& bin) const {
    return static_cast<std::size_t>(bin.first) * 73856093U ^ static_cast<std::size_t>(bin.second) * 19349663U;
  }
};

bool isUsable(const Eigen::Vector3f& p) { return p.allFinite() && p.cwiseAbs().maxCoeff() <= kFarthest; }

/// Keeps the points of the square of edge `extent` that holds most of them, to a tenth of its edge.
void keepDensestRegion(std::vector<Eigen::Vector3f>& points, double extent) {
  constexpr long kReach = 5;  // a window is 11 x 11 bins
  const double edge = extent / (2 * kReach + 1);
  std::map<Bin, std::size_t> bins;
  for (const auto& p : points) ++bins[binOf(p, edge)];
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
    const Bin bin = binOf(p, edge);
    return std::labs(bin.first - best.first) > kReach || std::labs(bin.second - best.second) > kReach;
  };
  points.erase(std::remove_if(points.begin(), points.end(), outside), points.end());
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
  require(settings.cap > 0 && std::isfinite(settings.cap), "cap must be positive [m]");
  require(settings.max_spike >= 0, "max_spike must not be negative [m]");
  require(settings.max_extent >= 10 * settings.resolution && settings.max_extent / settings.resolution <= 20000,
          "max_extent must be 10 to 20000 cells [m]");
}

std::vector<Eigen::Vector3f> withoutHiddenTops(const std::vector<Eigen::Vector3f>& points,
                                               const std::vector<float>& hidden_from, double resolution) {
  constexpr float kAbove = 0.1f, kAbout = 0.15f;  // the point; where it is hidden from: an edge that was seen [m]
  if (points.size() != hidden_from.size())
    throw std::invalid_argument("withoutHiddenTops: as many heights as points are needed");
  const auto isHidden = [&](std::size_t i) { return !std::isnan(hidden_from[i]) && isUsable(points[i]); };
  std::unordered_map<Bin, std::vector<float>, BinHash> heights;  // of cells with hidden points
  for (std::size_t i = 0; i < points.size(); ++i)
    if (isHidden(i)) heights[binOf(points[i], resolution)];
  if (heights.empty()) return points;
  for (const auto& p : points) {
    if (!isUsable(p)) continue;
    const auto cell = heights.find(binOf(p, resolution));
    if (cell != heights.end()) cell->second.push_back(p.z());
  }
  std::vector<Eigen::Vector3f> result;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (isHidden(i)) {
      const std::vector<float>& cell = heights[binOf(points[i], resolution)];
      const bool seen = std::any_of(cell.begin(), cell.end(),
                                    [&](float z) { return z > points[i].z() + kAbove && z < hidden_from[i] + kAbout; });
      if (!seen) continue;
    }
    result.push_back(points[i]);
  }
  return result;
}

HeightMap buildHeightMap(const std::vector<Eigen::Vector3f>& points, const HeightMapSettings& settings,
                         std::size_t* cropped, const LevelHistogram* earlier) {
  validate(settings);
  if (cropped) *cropped = 0;
  std::vector<Eigen::Vector3f> valid;
  valid.reserve(points.size());
  for (const auto& p : points) {
    if (isUsable(p)) valid.push_back(p);
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
  fillCells(sorted, begin, settings, earlier, map);
  if (map.defined() == 0) {
    HeightMap none;
    none.resolution = settings.resolution;
    return none;
  }
  return map;
}

HeightMap dilate(const HeightMap& map, Dilation mode) {
  if (mode == Dilation::kNone || map.empty()) return map;
  HeightMap result = map;
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      if (mode == Dilation::kHoles && !std::isnan(map.at(r, c))) continue;
      float highest = kHole;
      std::size_t from = 0;
      for (int y = std::max(r - 1, 0); y <= std::min(r + 1, map.height - 1); ++y) {
        for (int x = std::max(c - 1, 0); x <= std::min(c + 1, map.width - 1); ++x) {
          const float h = map.at(y, x);
          if (std::isnan(h) || h <= highest) continue;
          highest = h;
          from = static_cast<std::size_t>(y) * map.width + x;
        }
      }
      result.at(r, c) = highest;
      if (!map.bounds.empty()) result.bounds[static_cast<std::size_t>(r) * map.width + c] = map.bounds[from];
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
  result.floor = map.floor;
  result.cap = map.cap;
  result.heights.assign(static_cast<std::size_t>(result.width) * result.height, kHole);
  if (!map.bounds.empty()) result.bounds.assign(result.heights.size(), 0);
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      const float h = map.at(r, c);
      const std::size_t k = static_cast<std::size_t>(floorDiv(r0 + r) - R0) * result.width + (floorDiv(c0 + c) - C0);
      float& cell = result.heights[k];
      if (std::isnan(h) || h <= cell) continue;
      cell = h;
      if (!map.bounds.empty()) result.bounds[k] = map.bounds[static_cast<std::size_t>(r) * map.width + c];
    }
  }
  return result;
}

HeightMap scaled(const HeightMap& map, double scale) {
  if (!(scale > 0)) throw std::invalid_argument("scaled: the scale must be positive");
  if (map.empty() || scale == 1) return map;
  HeightMap result;
  result.resolution = map.resolution;
  result.floor = map.floor * scale;
  result.cap = map.cap;
  const long c0 = std::lround(std::floor(map.origin_x * scale / map.resolution)),
             r0 = std::lround(std::floor(map.origin_y * scale / map.resolution));
  result.origin_x = static_cast<double>(c0) * map.resolution;
  result.origin_y = static_cast<double>(r0) * map.resolution;
  result.width = static_cast<int>(std::ceil(map.width * scale)) + 1;
  result.height = static_cast<int>(std::ceil(map.height * scale)) + 1;
  result.heights.assign(static_cast<std::size_t>(result.width) * result.height, kHole);
  if (!map.bounds.empty()) result.bounds.assign(result.heights.size(), 0);
  for (int r = 0; r < result.height; ++r) {
    for (int c = 0; c < result.width; ++c) {
      const Eigen::Vector2d p = result.center(r, c) / scale;
      const int from_c = static_cast<int>(std::floor((p.x() - map.origin_x) / map.resolution));
      const int from_r = static_cast<int>(std::floor((p.y() - map.origin_y) / map.resolution));
      if (from_c < 0 || from_r < 0 || from_c >= map.width || from_r >= map.height) continue;
      const std::size_t from = static_cast<std::size_t>(from_r) * map.width + from_c;
      result.at(r, c) = static_cast<float>(map.heights[from] * scale);
      if (!map.bounds.empty()) result.bounds[static_cast<std::size_t>(r) * result.width + c] = map.bounds[from];
    }
  }
  return result;
}

HeightMap rotateAbout(const HeightMap& map, const Eigen::Vector2d& pivot, double yaw, int cells) {
  if (cells < 2 || cells % 2 != 0) throw std::invalid_argument("rotateAbout: cells must be positive and even");
  HeightMap result;
  result.resolution = map.resolution;
  result.floor = map.floor;
  result.cap = map.cap;
  result.width = result.height = cells;
  result.origin_x = result.origin_y = -0.5 * cells * map.resolution;
  result.heights.assign(static_cast<std::size_t>(cells) * cells, kHole);
  if (!map.bounds.empty()) result.bounds.assign(result.heights.size(), 0);
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
      const std::size_t from = static_cast<std::size_t>(static_cast<int>(y)) * map.width + static_cast<int>(x);
      const std::size_t to = static_cast<std::size_t>(row) * cells + column;
      result.heights[to] = map.heights[from];
      if (!map.bounds.empty()) result.bounds[to] = map.bounds[from];
    }
  }
  return result;
}

int boundLevel(const HeightMap& map, std::size_t cell) {
  if (!map.isBound(cell) || std::isnan(map.heights[cell])) return 0;
  // A hundredth of a level: the cap itself is the highest level in spite of rounding.
  const double level = (map.heights[cell] - map.floor) / map.cap * kBoundLevels + 0.01;
  return static_cast<int>(std::clamp(level, 0.0, kBoundLevels + 0.5));
}

double baseHeight(const HeightMap& map) {
  if (!std::isnan(map.floor)) return map.floor;
  double sum = 0;
  std::size_t n = 0;
  for (float h : map.heights) {
    if (std::isnan(h)) continue;
    sum += h;
    ++n;
  }
  return n > 0 ? sum / static_cast<double>(n) : 0;
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

double raisedShare(const HeightMap& map, double height) {
  const double base = baseHeight(map);
  std::size_t n = 0, raised = 0;
  for (float h : map.heights) {
    if (std::isnan(h)) continue;
    raised += h - base > height;
    ++n;
  }
  return n == 0 ? 0 : static_cast<double>(raised) / static_cast<double>(n);
}

}  // namespace heightmap_mcl
