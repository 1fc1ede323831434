#include "icp_refine/height_check.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <random>

#include "air_ground_common/statistics.h"
#include "key_table.h"

namespace icp_refine {
namespace {

std::uint64_t column(int x, int y) { return cellKey({x + 0.5f, y + 0.5f, 0.f}, 1.f); }

// A guess that is far off moves points to where there are no cells: they share the last.
int cellOf(float v, double cell) {
  constexpr double kLast = 1e9;
  return static_cast<int>(std::max(-kLast, std::min(kLast, std::floor(v / cell))));
}

// Highest point of each column.
struct Columns {
  Columns(const Cloud& cloud, double cell) {
    for (const auto& p : cloud.points) {
      const int x = cellOf(p.x(), cell), y = cellOf(p.y(), cell);
      const auto k = static_cast<std::size_t>(keys.insert(column(x, y)));
      if (k == tops.size()) {
        tops.push_back(p.z());
        places.emplace_back(static_cast<float>(x), static_cast<float>(y));
      } else {
        tops[k] = std::max(tops[k], p.z());
      }
    }
  }
  /// `unseen` where there is no point.
  float top(std::uint64_t key, float unseen) const {
    const int k = keys.find(key);
    return k < 0 ? unseen : tops[static_cast<std::size_t>(k)];
  }
  bool seen(std::uint64_t key) const { return keys.find(key) >= 0; }
  int x(std::size_t k) const { return static_cast<int>(places[k].x()); }
  int y(std::size_t k) const { return static_cast<int>(places[k].y()); }
  std::uint64_t key(std::size_t k) const { return column(x(k), y(k)); }

  KeyTable keys;
  std::vector<float> tops;
  std::vector<Eigen::Vector2f> places;  // in cells
};

constexpr double kFloorNoise = 0.05;  // [m]

// Most frequent height, by bins of that.
double mode(const Columns& columns) {
  std::map<int, int> histogram;
  for (float z : columns.tops) ++histogram[static_cast<int>(std::lround(z / kFloorNoise))];
  int best = 0, count = -1;
  for (const auto& [bin, n] : histogram) {
    if (n > count) best = bin, count = n;
  }
  return kFloorNoise * best;
}

struct Floor {
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();  // [m a cell]
  double height = 0;                                // at cell (0, 0) [m]
  double at(double x, double y) const { return height + slope.x() * x + slope.y() * y; }
};

/// Level at the most frequent height, or the plane that clearly more columns lie on: a slope tells no place along its
/// contours.
Floor floorOf(const Columns& columns, double cell) {
  constexpr int kTrials = 200, kSamples = 1500;
  constexpr double kSteepest = 0.3, kClearly = 1.3;
  Floor best;
  best.height = mode(columns);
  const std::size_t n = columns.tops.size(), step = std::max<std::size_t>(1, n / kSamples);
  const auto support = [&](const Floor& floor) {
    int count = 0;
    for (std::size_t k = 0; k < n; k += step)
      count += std::abs(columns.tops[k] - floor.at(columns.places[k].x(), columns.places[k].y())) < kFloorNoise;
    return count;
  };
  double needed = kClearly * support(best);
  std::mt19937 random(1);
  for (int trial = 0; trial < kTrials && n >= 3; ++trial) {
    Eigen::Matrix3d A;
    Eigen::Vector3d z;
    for (int i = 0; i < 3; ++i) {
      const std::size_t k = random() % n;
      A.row(i) << columns.places[k].x(), columns.places[k].y(), 1;
      z[i] = columns.tops[k];
    }
    if (std::abs(A.determinant()) < 1) continue;
    const Eigen::Vector3d plane = A.inverse() * z;
    const Floor floor{plane.head<2>(), plane[2]};
    if (floor.slope.norm() > kSteepest * cell) continue;
    const int count = support(floor);
    if (count <= needed) continue;
    needed = count;
    best = floor;
  }
  return best;
}

}  // namespace

struct GroundHeights::Maps {
  Maps(const Cloud& ground, const HeightCheckSettings& s)
      : columns(ground, s.cell), floor(floorOf(columns, s.cell)), near_cell(std::max(s.margin / 2, 1e-3)) {
    KeyTable seen;
    for (const auto& p : ground.points) {
      const int x = cellOf(p.x(), near_cell), y = cellOf(p.y(), near_cell);
      const int before = seen.size();
      if (seen.insert(column(x, y)) < before) continue;
      for (int dy = -2; dy <= 2; ++dy) {
        for (int dx = -2; dx <= 2; ++dx) near.insert(column(x + dx, y + dy));
      }
    }
  }
  Columns columns;
  Floor floor;
  double near_cell;  // half the margin [m]
  KeyTable near;     // cells of that edge where the map is, grown by two
};

GroundHeights::GroundHeights(const Cloud& ground, const HeightCheckSettings& settings)
    : settings_(settings), maps_(std::make_shared<const Maps>(ground, settings)) {}

HeightCheck GroundHeights::check(const Cloud& aerial, double ground_camera) const {
  const HeightCheckSettings& s = settings_;
  const Columns& floor_robot = maps_->columns;
  HeightCheck out;
  const Columns air(aerial, s.cell);
  out.aerial_cells = air.keys.size();
  const int reach = std::max(1, static_cast<int>(std::lround(s.tolerance_xy / s.cell)));

  // Highest value of a column's neighbourhood; an unseen column counts as infinitely high: it may hold the object.
  constexpr float kUnseen = std::numeric_limits<float>::infinity();
  const auto highest = [reach](const Columns& columns, int x, int y) {
    float best = -kUnseen;
    for (int dy = -reach; dy <= reach; ++dy) {
      for (int dx = -reach; dx <= reach; ++dx) {
        if (dx * dx + dy * dy > reach * reach) continue;
        best = std::max(best, columns.top(column(x + dx, y + dy), kUnseen));
      }
    }
    return best;
  };
  // Relief that one cloud has there and the other has not.
  const auto count = [&out](float seen_beside, double needed) {
    if (seen_beside == kUnseen) return;
    ++out.relief_cells;
    out.contradictions += seen_beside < needed;
  };

  for (std::size_t k = 0; k < air.tops.size(); ++k) {
    if (!floor_robot.seen(air.key(k))) continue;
    ++out.cells;
    const int x = air.x(k), y = air.y(k);
    const float from_air = air.tops[k], from_ground = floor_robot.top(air.key(k), 0);
    const double level = maps_->floor.at(x, y);
    const bool air_relief = std::abs(from_air - level) > s.relief;
    const bool ground_relief = std::abs(from_ground - level) > s.relief;
    if (!air_relief && !ground_relief) continue;
    if (from_ground > from_air + s.tolerance_z) {
      count(highest(air, x, y), from_ground - s.tolerance_z);
    } else if (air_relief && !ground_relief && from_air > from_ground + s.tolerance_z) {
      const float beside = highest(floor_robot, x, y);
      const bool hidden = from_air > ground_camera - s.tolerance_z && beside < level + s.relief;
      if (!hidden) count(beside, level + s.relief);
    } else {
      ++out.relief_cells;
    }
  }
  out.conclusive = out.relief_cells >= s.min_relief_cells;
  return out;
}

std::optional<double> GroundHeights::offset(const Cloud& aerial) const {
  const Columns air(aerial, settings_.cell);
  std::vector<double> differences;
  for (std::size_t k = 0; k < air.tops.size(); ++k) {
    if (maps_->columns.seen(air.key(k))) differences.push_back(maps_->columns.top(air.key(k), 0) - air.tops[k]);
  }
  if (differences.size() < 50) return std::nullopt;
  return air_ground_common::median(std::move(differences));
}

std::vector<char> GroundHeights::near(const Cloud& aerial) const {
  std::vector<char> mask(aerial.size());
  for (std::size_t i = 0; i < aerial.size(); ++i) {
    const auto& p = aerial.points[i];
    mask[i] = maps_->near.find(column(cellOf(p.x(), maps_->near_cell), cellOf(p.y(), maps_->near_cell))) >= 0;
  }
  return mask;
}

}  // namespace icp_refine
