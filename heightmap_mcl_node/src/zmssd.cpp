#include "heightmap_mcl/zmssd.h"

#include <cmath>
#include <stdexcept>
#include <utility>

#include "partners.h"
#include "zmssd_kernel.h"

namespace heightmap_mcl {

PlanarPose changeReference(const PlanarPose& pose, const Eigen::Vector2d& from, const Eigen::Vector2d& to) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const Eigen::Vector2d d = to - from;
  return {pose.x + c * d.x() - s * d.y(), pose.y + s * d.x() + c * d.y(), pose.yaw};
}

PlanarPose planarOf(const air_ground_common::Pose& T_ground_air, const Eigen::Vector2d& reference) {
  const Eigen::Vector3d p = T_ground_air * Eigen::Vector3d(reference.x(), reference.y(), 0);
  return {p.x(), p.y(), air_ground_common::yawOf(T_ground_air.rotation())};
}

void validate(const CostSettings& settings) {
  if (!(settings.min_overlap > 0 && settings.min_overlap <= 1)) {
    throw std::invalid_argument("cost settings: min_overlap must be in (0, 1]");
  }
  if (!(settings.unknown_cost >= 0 && std::isfinite(settings.unknown_cost))) {
    throw std::invalid_argument("cost settings: unknown_cost must not be negative [m^2]");
  }
  if (!(settings.min_explained >= 0 && settings.min_explained < 1 && settings.min_relief >= 0)) {
    throw std::invalid_argument("cost settings: min_explained must be in [0, 1), min_relief must not be negative [m]");
  }
  if (!(settings.cutoff > 0)) throw std::invalid_argument("cost settings: cutoff must be positive [m]");
}

namespace {

constexpr double kNoLimit = 1e9;  // [m]

CellHeight heightOf(const HeightMap& map, std::size_t cell, double base) {
  const int level = boundLevel(map, cell);
  const double value = level > 0 ? map.cap * level / kBoundLevels : map.heights[cell] - base;
  return {value, level > 0, value, level > 0 ? kNoLimit : value};
}

/// The greatest of the values within `reach` cells in both directions.
std::vector<float> greatestNear(const std::vector<float>& values, int width, int height, int reach) {
  if (reach == 0) return values;
  std::vector<float> rows = values, out = values;
  for (int r = 0; r < height; ++r) {
    for (int c = 0; c < width; ++c) {
      const auto begin = values.begin() + static_cast<std::ptrdiff_t>(r) * width;
      rows[static_cast<std::size_t>(r) * width + c] =
          *std::max_element(begin + std::max(0, c - reach), begin + std::min(width, c + reach + 1));
    }
  }
  for (int r = 0; r < height; ++r) {
    for (int other = std::max(0, r - reach); other <= std::min(height - 1, r + reach); ++other) {
      const std::size_t here = static_cast<std::size_t>(r) * width, there = static_cast<std::size_t>(other) * width;
      for (int c = 0; c < width; ++c) out[here + c] = std::max(out[here + c], rows[there + c]);
    }
  }
  return out;
}

constexpr double kUnseen = 0.35;  // of the cells around one at the rim; along a straight rim two fifths or more

/// Whether much of what lies within `edge` cells was not seen: the map's rim, or that of a hole. What stands there may
/// begin at the next cell.
bool atRim(const HeightMap& map, int row, int column, int edge) {
  int unseen = 0;
  for (int r = row - edge; r <= row + edge; ++r)
    for (int c = column - edge; c <= column + edge; ++c)
      unseen += r < 0 || c < 0 || r >= map.height || c >= map.width || std::isnan(map.at(r, c));
  return unseen > kUnseen * (2 * edge + 1) * (2 * edge + 1);
}

/// atRim of every cell, in a time that does not depend on `edge`.
class Rims {
 public:
  Rims(const HeightMap& map, int edge)
      : width_(map.width), height_(map.height), edge_(edge), seen_((width_ + 1) * (height_ + 1), 0) {
    for (std::size_t r = 0; r < height_; ++r) {
      for (std::size_t c = 0, row = 0; c < width_; ++c) {
        row += !std::isnan(map.heights[r * width_ + c]);
        seen_[(r + 1) * (width_ + 1) + c + 1] = seen_[r * (width_ + 1) + c + 1] + row;
      }
    }
  }
  bool at(std::size_t row, std::size_t column) const {
    const std::size_t r0 = row - std::min(row, edge_), c0 = column - std::min(column, edge_);
    const std::size_t r1 = std::min(row + edge_ + 1, height_), c1 = std::min(column + edge_ + 1, width_);
    const auto before = [this](std::size_t r, std::size_t c) { return seen_[r * (width_ + 1) + c]; };
    const std::size_t seen = before(r1, c1) + before(r0, c0) - before(r0, c1) - before(r1, c0);
    const std::size_t all = (2 * edge_ + 1) * (2 * edge_ + 1);
    return static_cast<double>(all - seen) > kUnseen * static_cast<double>(all);
  }

 private:
  std::size_t width_, height_, edge_;
  std::vector<std::size_t> seen_;  // in the rows and columns before
};

/// The same with what lies within `edge` cells, where there is a step.
CellHeight heightNear(const HeightMap& map, int row, int column, double base, int edge) {
  const auto cell = [&map](int r, int c) { return static_cast<std::size_t>(r) * map.width + c; };
  CellHeight height = heightOf(map, cell(row, column), base);
  double low = height.low, high = height.high;
  for (int r = std::max(0, row - edge); r <= std::min(map.height - 1, row + edge); ++r) {
    for (int c = std::max(0, column - edge); c <= std::min(map.width - 1, column + edge); ++c) {
      if (std::isnan(map.at(r, c))) continue;
      const CellHeight other = heightOf(map, cell(r, c), base);
      low = std::min(low, other.low);
      high = std::max(high, other.high);
    }
  }
  if (high - low > kEdgeStep) {
    height.low = low;
    height.high = high;
  }
  if (atRim(map, row, column, edge)) height.high = kNoLimit;
  return height;
}

}  // namespace

Partners partnersOf(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                    const PlanarPose& pose, int edge) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const double air_base = baseHeight(air), ground_base = baseHeight(ground);
  Partners pairs;
  for (int row = 0; row < air.height; ++row) {
    for (int column = 0; column < air.width; ++column) {
      if (std::isnan(air.at(row, column))) continue;
      const Eigen::Vector2d q = air.center(row, column) - reference;
      const double x = c * q.x() - s * q.y() + pose.x, y = s * q.x() + c * q.y() + pose.y;
      const double gc = std::floor((x - ground.origin_x) / ground.resolution);
      const double gr = std::floor((y - ground.origin_y) / ground.resolution);
      if (gc < 0 || gr < 0 || gc >= ground.width || gr >= ground.height) continue;
      const std::size_t cell = static_cast<std::size_t>(gr) * ground.width + static_cast<std::size_t>(gc);
      if (std::isnan(ground.heights[cell])) continue;
      pairs.emplace_back(heightNear(air, row, column, air_base, edge), heightOf(ground, cell, ground_base));
    }
  }
  return pairs;
}

Zmssd zmssdReference(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                     const PlanarPose& pose, const CostSettings& settings, int edge) {
  const Partners pairs = partnersOf(air, ground, reference, pose, edge);
  // The means first, then the squares about them: no cancellation.
  double mean_a = 0, mean_g = 0, mean_d = 0, known = 0;
  for (const auto& [a, g] : pairs) {
    mean_a += a.value / static_cast<double>(pairs.size());
    mean_g += g.value / static_cast<double>(pairs.size());
    if (!a.known() || g.bound) continue;
    mean_d += a.value - g.value;
    ++known;
  }
  if (known > 0) mean_d /= known;
  OverlapSums sums;
  sums.known = known;
  for (const auto& [a, g] : pairs) {
    ++sums.n;
    if (a.known() && !g.bound) {
      sums.d2 += std::pow(a.value - g.value - mean_d, 2);
    } else {
      sums.d2 += std::pow(lackOf(a, g), 2);
    }
    sums.a2 += (a.value - mean_a) * (a.value - mean_a);
    sums.g2 += (g.value - mean_g) * (g.value - mean_g);
  }
  const double smaller = settings.cells(static_cast<double>(air.defined()), static_cast<double>(ground.defined()));
  Zmssd result = zmssdFromSums(sums, smaller, settings);
  if (std::isfinite(result.cost)) result.dz = baseHeight(ground) - baseHeight(air) - mean_d;
  return result;
}

AerialCells aerialCells(const HeightMap& air, const Eigen::Vector2d& reference, int edge) {
  AerialCells cells;
  cells.reference = reference;
  cells.base = baseHeight(air);
  const std::size_t n = air.defined(), all = air.heights.size();
  for (auto* v : {&cells.x, &cells.y, &cells.h, &cells.low, &cells.high}) v->reserve(n);
  constexpr float kNone = -std::numeric_limits<float>::infinity();
  std::vector<float> high(all, kNone), minus_low(all, kNone);
  for (std::size_t i = 0; i < all; ++i) {
    if (std::isnan(air.heights[i])) continue;
    const CellHeight height = heightOf(air, i, cells.base);
    high[i] = static_cast<float>(height.high);
    minus_low[i] = static_cast<float>(-height.low);
  }
  const std::vector<float> high_near = greatestNear(high, air.width, air.height, edge);
  const std::vector<float> minus_low_near = greatestNear(minus_low, air.width, air.height, edge);
  const Rims rims(air, edge);
  double sum = 0;
  for (int row = 0; row < air.height; ++row) {
    for (int column = 0; column < air.width; ++column) {
      if (std::isnan(air.at(row, column))) continue;
      const std::size_t i = static_cast<std::size_t>(row) * air.width + column;
      const Eigen::Vector2d q = air.center(row, column) - reference;
      const CellHeight height = heightOf(air, i, cells.base);
      const bool step = high_near[i] + minus_low_near[i] > static_cast<float>(kEdgeStep);
      cells.x.push_back(static_cast<float>(q.x()));
      cells.y.push_back(static_cast<float>(q.y()));
      cells.h.push_back(static_cast<float>(height.value));
      cells.low.push_back(-(step ? minus_low_near[i] : minus_low[i]));
      cells.high.push_back(rims.at(row, column) ? static_cast<float>(kNoLimit) : step ? high_near[i] : high[i]);
      sum += height.value;
    }
  }
  cells.mean_height = cells.base + (n > 0 ? sum / static_cast<double>(n) : 0);
  return cells;
}

AerialCells about(AerialCells cells, const Eigen::Vector2d& reference) {
  const Eigen::Vector2d shift = reference - cells.reference;
  cells.reference = reference;
  for (std::size_t i = 0; i < cells.h.size(); ++i) {
    cells.x[i] -= static_cast<float>(shift.x());
    cells.y[i] -= static_cast<float>(shift.y());
  }
  return cells;
}

AerialCells thinned(const AerialCells& cells, int stride) {
  AerialCells result;
  result.weight = cells.weight * stride;
  result.base = cells.base;
  result.mean_height = cells.mean_height;
  result.reference = cells.reference;
  for (std::size_t i = 0; i < cells.h.size(); i += stride) {
    result.x.push_back(cells.x[i]);
    result.y.push_back(cells.y[i]);
    result.h.push_back(cells.h[i]);
    result.low.push_back(cells.low[i]);
    result.high.push_back(cells.high[i]);
  }
  return result;
}

DirectCost::DirectCost(const HeightMap& ground)
    : resolution_(ground.resolution),
      origin_x_(ground.origin_x - ground.resolution),
      origin_y_(ground.origin_y - ground.resolution),
      base_(baseHeight(ground)),
      width_(ground.width + 2),
      height_(ground.height + 2),
      heights_(static_cast<std::size_t>(width_) * height_, kHole) {
  for (int r = 0; r < ground.height; ++r) {
    for (int c = 0; c < ground.width; ++c) {
      if (std::isnan(ground.at(r, c))) continue;
      ++defined_;
      const CellHeight height = heightOf(ground, static_cast<std::size_t>(r) * ground.width + c, base_);
      heights_[static_cast<std::size_t>(r + 1) * width_ + c + 1] =
          static_cast<float>(height.value) + (height.bound ? kernel::kBoundOffset : 0.f);
    }
  }
  if (defined_ == 0) throw std::invalid_argument("DirectCost: the ground height map has no defined cell");
}

Zmssd DirectCost::operator()(const AerialCells& cells, const PlanarPose& pose, const CostSettings& settings) const {
  auto sums = kernel::overlapSums(kernel::viewOf(cells), {pose, resolution_, origin_x_, origin_y_},
                                  {heights_.data(), width_, height_});
  for (double* sum : {&sums.n, &sums.known, &sums.d, &sums.d2, &sums.a, &sums.a2, &sums.g, &sums.g2})
    *sum *= cells.weight;
  const double smaller = settings.cells(static_cast<double>(cells.weight * cells.h.size()), defined_);
  Zmssd result = zmssdFromSums(sums, smaller, settings);
  if (std::isfinite(result.cost)) result.dz += base_ - cells.base;
  return result;
}

std::vector<Zmssd> DirectCost::operator()(const AerialCells& cells, const std::vector<PlanarPose>& poses,
                                          const CostSettings& settings) const {
  std::vector<Zmssd> results(poses.size());
  const int n = static_cast<int>(poses.size());
  // Below some dozens of poses, waking the threads costs more than they save, the more so on a busy machine.
#pragma omp parallel for schedule(static) if (n > 60)
  for (int i = 0; i < n; ++i) results[i] = (*this)(cells, poses[i], settings);
  return results;
}

float DirectCost::groundAt(double x, double y) const {
  const double c = std::floor((x - origin_x_) / resolution_), r = std::floor((y - origin_y_) / resolution_);
  if (c < 0 || r < 0 || c >= width_ || r >= height_) return kHole;
  return heights_[static_cast<std::size_t>(r) * width_ + static_cast<std::size_t>(c)];
}

DirectCost::Overlap DirectCost::overlapAt(const AerialCells& cells, const PlanarPose& pose) const {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const Eigen::Vector2d origin(pose.x, pose.y);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double squares = 0, n = 0;
  for (std::size_t i = 0; i < cells.h.size(); ++i) {
    const Eigen::Vector2d p(c * cells.x[i] - s * cells.y[i], s * cells.x[i] + c * cells.y[i]);
    if (std::isnan(groundAt(origin.x() + p.x(), origin.y() + p.y()))) continue;
    sum += p;
    squares += p.squaredNorm();
    ++n;
  }
  if (n == 0) return {origin, 0};
  const Eigen::Vector2d mean = sum / n;
  return {origin + mean, std::sqrt(std::max(0.0, squares / n - mean.squaredNorm()))};
}

}  // namespace heightmap_mcl
