#include "icp_refine/height_check.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
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

HeightCheck checkHeights(const Cloud& aerial, const Cloud& ground, const HeightCheckSettings& s, double ground_camera) {
  HeightCheck out;
  const Columns air(aerial, s.cell), floor_robot(ground, s.cell);
  const Floor floor = floorOf(floor_robot, s.cell);
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

  KeyTable done;
  for (const auto& p : aerial.points) {
    const int x = cellOf(p.x(), s.cell), y = cellOf(p.y(), s.cell);
    const auto key = column(x, y);
    if (!floor_robot.seen(key) || done.insert(key) != out.cells) continue;
    ++out.cells;
    const float from_air = air.top(key, 0), from_ground = floor_robot.top(key, 0);
    const double level = floor.at(x, y);
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

std::optional<double> heightOffset(const Cloud& aerial, const Cloud& ground, double cell) {
  const Columns air(aerial, cell), below(ground, cell);
  std::vector<double> differences;
  KeyTable done;
  for (const auto& p : aerial.points) {
    const auto key = column(cellOf(p.x(), cell), cellOf(p.y(), cell));
    const int before = done.size();
    if (below.seen(key) && done.insert(key) == before) differences.push_back(below.top(key, 0) - air.top(key, 0));
  }
  if (differences.size() < 50) return std::nullopt;
  return air_ground_common::median(std::move(differences));
}

std::vector<char> nearGroundMap(const Cloud& aerial, const Cloud& ground, double margin) {
  // Cells of half the margin, grown by two.
  const double cell = std::max(margin / 2, 1e-3);
  KeyTable seen, grown;
  for (const auto& p : ground.points) {
    const int x = cellOf(p.x(), cell), y = cellOf(p.y(), cell);
    const int before = seen.size();
    if (seen.insert(column(x, y)) < before) continue;
    for (int dy = -2; dy <= 2; ++dy) {
      for (int dx = -2; dx <= 2; ++dx) grown.insert(column(x + dx, y + dy));
    }
  }
  std::vector<char> mask(aerial.size());
  for (std::size_t i = 0; i < aerial.size(); ++i) {
    mask[i] = grown.find(column(cellOf(aerial.points[i].x(), cell), cellOf(aerial.points[i].y(), cell))) >= 0;
  }
  return mask;
}

}  // namespace icp_refine
