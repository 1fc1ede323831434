#include "heightmap_mcl/global_search.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "air_ground_common/first_exception.h"
#include "air_ground_common/geometry.h"
#include "cell_box.h"

namespace heightmap_mcl {

using air_ground_common::wrapAngle;

double Prior::logDensity(const PlanarPose& pose, const Eigen::Vector2d& reference) const {
  double log_density = 0;
  if (yaw) {
    const double d = wrapAngle(pose.yaw - *yaw) / yaw_sigma;
    log_density -= 0.5 * d * d;
  }
  if (position) {
    const PlanarPose there = changeReference(pose, reference, position_reference);
    const double squared = (Eigen::Vector2d(there.x, there.y) - *position).squaredNorm();
    if (position_radius > 0) {
      if (squared > position_radius * position_radius) log_density = -kInfinity;
    } else {
      log_density -= 0.5 * squared / (position_sigma * position_sigma);
    }
  }
  return log_density;
}

std::vector<double> searchHeadings(int count, const Prior& prior) {
  if (count < 4) throw std::invalid_argument("searchHeadings: at least 4 headings");
  const double step = 2 * M_PI / count;
  std::vector<double> headings;
  if (!prior.yaw || 3 * prior.yaw_sigma >= M_PI) {
    for (int i = 0; i < count; ++i) headings.push_back(wrapAngle(i * step));
    return headings;
  }
  const double fine = std::min(step, prior.yaw_sigma);
  const int half = static_cast<int>(std::ceil(3 * prior.yaw_sigma / fine));
  for (int i = -half; i <= half; ++i) headings.push_back(wrapAngle(*prior.yaw + i * fine));
  return headings;
}

double CostVolume::lowest() const {
  float low = std::numeric_limits<float>::infinity();
  for (const auto& slice : slices) {
    for (float c : slice.cost) low = std::min(low, c);
  }
  return low;
}

Eigen::Vector2d centerOf(const HeightMap& map) {
  const auto box = definedBox(map);
  if (!box) return Eigen::Vector2d::Zero();
  return {map.origin_x + 0.5 * (box->c0 + box->c1 + 1) * map.resolution,
          map.origin_y + 0.5 * (box->r0 + box->r1 + 1) * map.resolution};
}

CostVolume computeCostVolume(const FftCost& fft, const HeightMap& air, const std::vector<double>& headings,
                             bool circular, const CostSettings& settings) {
  CostVolume volume;
  volume.circular = circular;
  volume.pivot = centerOf(air);
  // The square that holds the defined cells at any heading.
  double radius = 0;
  for (int r = 0; r < air.height; ++r) {
    for (int c = 0; c < air.width; ++c) {
      if (!std::isnan(air.at(r, c))) radius = std::max(radius, (air.center(r, c) - volume.pivot).squaredNorm());
    }
  }
  const int cells = 2 * static_cast<int>(std::ceil(std::sqrt(radius) / air.resolution + 1));
  volume.slices.resize(headings.size());
  const int all = static_cast<int>(headings.size());
  // Round the circle the second half of an even number of headings is opposite to the first.
  const bool in_pairs = circular && all % 2 == 0;
  const int n = in_pairs ? all / 2 : all;
  std::vector<HeightMap> turned(n);
  std::vector<FftSize> sizes(n);
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(dynamic)
  for (int i = 0; i < n; ++i) {
    failure.guard([&] {
      turned[i] = rotateAbout(air, volume.pivot, headings[i], cells);
      sizes[i] = fft.sizeFor(turned[i], settings);
    });
  }
  failure.rethrow();
  FftSize size;
  for (const FftSize& s : sizes) size = {std::max(size.rows, s.rows), std::max(size.columns, s.columns)};
#pragma omp parallel for schedule(dynamic)
  for (int i = 0; i < n; ++i) {
    failure.guard([&] {
      if (in_pairs) {
        auto maps = fft.andOpposite(turned[i], headings[i], settings, size);
        volume.slices[i] = std::move(maps[0]);
        volume.slices[i + n] = std::move(maps[1]);
      } else {
        volume.slices[i] = fft(turned[i], headings[i], settings, size);
      }
    });
  }
  failure.rethrow();
  return volume;
}

std::vector<PlanarPose> findLocalMinima(const CostVolume& volume, std::size_t count, double distance, double angle,
                                        const Prior& prior) {
  struct Entry {
    float cost;
    int slice, row, column;
  };
  std::vector<Entry> entries;
  const int n = static_cast<int>(volume.slices.size());
  for (int k = 0; k < n; ++k) {
    const CostMap& map = volume.slices[k];
    for (int r = 0; r < map.height; ++r) {
      for (int c = 0; c < map.width; ++c) {
        const float cost = map.at(r, c);
        if (!std::isfinite(cost)) continue;
        bool minimum = true;
        for (int dk = -1; dk <= 1 && minimum; ++dk) {
          int kk = k + dk;
          if (volume.circular) kk = (kk + n) % n;
          if (kk < 0 || kk >= n) continue;
          const CostMap& other = volume.slices[kk];
          for (int rr = std::max(r - 1, 0); rr <= std::min(r + 1, map.height - 1) && minimum; ++rr) {
            for (int cc = std::max(c - 1, 0); cc <= std::min(c + 1, map.width - 1); ++cc) {
              if (other.at(rr, cc) < cost) {
                minimum = false;
                break;
              }
            }
          }
        }
        if (minimum && prior.allows(map.pose(r, c), volume.pivot)) entries.push_back({cost, k, r, c});
      }
    }
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.cost < b.cost; });
  std::vector<PlanarPose> minima;
  for (const Entry& e : entries) {
    if (minima.size() >= count) break;
    const PlanarPose pose = volume.slices[e.slice].pose(e.row, e.column);
    const bool apart = std::all_of(minima.begin(), minima.end(), [&](const PlanarPose& other) {
      return std::hypot(pose.x - other.x, pose.y - other.y) >= distance ||
             std::abs(wrapAngle(pose.yaw - other.yaw)) >= angle;
    });
    if (apart) minima.push_back(pose);
  }
  return minima;
}

Placement descend(const DirectCost& cost, const AerialCells& cells, const PlanarPose& start, double step_xy,
                  double step_yaw, const CostSettings& settings) {
  constexpr int kLevels = 4, kCoarseLevels = 2, kMovesPerLevel = 6;
  // Far from the minimum a quarter of the cells says where it lies, or some thousand of a large map, and every
  // neighbour is looked at; near it heading and position hardly interact, and one axis at a time will do.
  constexpr std::size_t kStride = 4, kEnough = 8192, kEnoughNear = 65536;
  constexpr int kAxes[] = {4, 10, 12, 14, 16, 22};
  const AerialCells thin = thinned(cells, static_cast<int>(std::max(kStride, cells.h.size() / kEnough)));
  std::optional<AerialCells> fewer;
  if (const std::size_t stride = cells.h.size() / kEnoughNear; stride > 1)
    fewer = thinned(cells, static_cast<int>(stride));
  const AerialCells& fine = fewer ? *fewer : cells;
  // What agrees with the best pose so far says how far the heights lie apart.
  Placement best{start, cost.agreement(thin, start, cost.medianOffset(thin, start), settings)};
  const auto at = [&](const PlanarPose& pose, bool coarse) {
    return Placement{pose, cost.agreement(coarse ? thin : fine, pose, best.agreement.offset, settings)};
  };
  for (int level = 0; level < kLevels; ++level, step_xy *= 0.5, step_yaw *= 0.5) {
    const bool coarse = level < kCoarseLevels;
    if (level == kCoarseLevels) best = at(best.pose, false);
    for (int move = 0; move < kMovesPerLevel; ++move) {
      Placement lowest = best;
      for (int i = 0; i < 27; ++i) {
        if (i == 13 || (!coarse && std::find(std::begin(kAxes), std::end(kAxes), i) == std::end(kAxes))) continue;
        const Placement found = at({best.pose.x + (i % 3 - 1) * step_xy, best.pose.y + (i / 3 % 3 - 1) * step_xy,
                                    best.pose.yaw + (i / 9 - 1) * step_yaw},
                                   coarse);
        if (found.agreement.score < lowest.agreement.score) lowest = found;
      }
      if (!(lowest.agreement.score < best.agreement.score)) break;
      best = lowest;
    }
  }
  // Sub-cell: the cost is a mean over thousands of cells and therefore smooth at the scale of one.
  const double h_xy = 1.5 * step_xy * 2, h_yaw = 1.5 * step_yaw * 2;
  const PlanarPose& p = best.pose;
  const auto shift = [&](const PlanarPose& before, const PlanarPose& after) {
    const double low = at(before, false).agreement.score, high = at(after, false).agreement.score;
    const double bend = low - 2 * best.agreement.score + high;
    return std::isfinite(bend) && bend > 0 ? std::clamp(0.5 * (low - high) / bend, -0.5, 0.5) : 0.0;
  };
  const Placement vertex = at({p.x + h_xy * shift({p.x - h_xy, p.y, p.yaw}, {p.x + h_xy, p.y, p.yaw}),
                               p.y + h_xy * shift({p.x, p.y - h_xy, p.yaw}, {p.x, p.y + h_xy, p.yaw}),
                               p.yaw + h_yaw * shift({p.x, p.y, p.yaw - h_yaw}, {p.x, p.y, p.yaw + h_yaw})},
                              false);
  if (vertex.agreement.score <= best.agreement.score) best = vertex;
  if (fewer) best.agreement = cost.agreement(cells, best.pose, best.agreement.offset, settings);
  best.pose.yaw = wrapAngle(best.pose.yaw);
  return best;
}

std::vector<Placement> placesOfMinima(const CostVolume& volume, std::size_t count, double distance, double angle,
                                      const Prior& prior, const DirectCost& cost, const AerialCells& cells,
                                      double step_xy, double step_yaw, const CostSettings& settings) {
  const std::vector<PlanarPose> minima = findLocalMinima(volume, count, distance, angle, prior);
  std::vector<Placement> places(minima.size());
  const int n = static_cast<int>(minima.size());
#pragma omp parallel for schedule(dynamic)
  for (int i = 0; i < n; ++i) {
    const PlanarPose start = changeReference(minima[i], volume.pivot, cells.reference);
    places[i] = descend(cost, cells, start, step_xy, step_yaw, settings);
  }
  return places;
}

Placement bestOf(const std::vector<Placement>& places) {
  Placement best;
  for (const Placement& place : places)
    if (place.agreement.score < best.agreement.score) best = place;
  return best;
}

}  // namespace heightmap_mcl
