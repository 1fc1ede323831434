// Zero-mean sum of squared differences of two height maps (Forster 2013, eq. 2), evaluated at single poses.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <vector>

#include "heightmap_mcl/height_map.h"

namespace heightmap_mcl {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Where the aerial map lies in the ground map: p_ground = R(yaw) (p_air - reference) + (x, y), for a reference point
/// given beside it. yaw is the heading of the aerial frame's x axis in the ground frame.
struct PlanarPose {
  double x = 0;    ///< position of the reference point in the ground frame [m]
  double y = 0;    ///< [m]
  double yaw = 0;  ///< [rad]
};

/// The same placement stated for another reference point (both in the aerial frame).
PlanarPose changeReference(const PlanarPose& pose, const Eigen::Vector2d& from, const Eigen::Vector2d& to);

struct CostSettings {
  /// Cells that must be defined in both maps, as a share of the defined cells of the aerial map (paper), or of the ground
  /// map where that is the smaller one, in (0, 1].
  double min_overlap = 0.5;
  /// Charged for cells of the smaller map without a partner [m^2]: score = eq. 2 + unknown_cost * (1 - that share); 0 = paper.
  /// Without it a placement gains by hiding the structure it cannot explain in the ground map's holes.
  double unknown_cost = 0;
};

/// Checks ranges; throws std::invalid_argument naming the field.
void validate(const CostSettings& settings);

struct Zmssd {
  int overlap = 0;           ///< cells defined in both maps
  double cost = kInfinity;   ///< eq. 2 [m^2], eta = 1 / (2 overlap); infinite below the overlap threshold
  double score = kInfinity;  ///< what placements are compared by [m^2], see CostSettings::unknown_cost
  double dz = 0;             ///< mean of ground minus aerial height over the overlap: what lifts the aerial map [m]
};

/// Cost from the number, sum and sum of squares of d = aerial - ground over the overlap. `cells`: defined cells of the
/// smaller map.
inline Zmssd zmssdFromSums(double n, double sum, double squares, double cells, const CostSettings& settings) {
  Zmssd result;
  result.overlap = static_cast<int>(n + 0.5);
  if (n < 1 || n < settings.min_overlap * cells) return result;
  const double spread = squares - sum * sum / n;
  result.cost = (spread > 0 ? spread : 0) / (2 * n);
  result.score = result.cost + settings.unknown_cost * std::max(0.0, 1 - n / cells);
  result.dz = -sum / n;
  return result;
}

/// Reference: double precision, one cell after the other, nearest ground cell. `pose` places `reference` (aerial frame).
Zmssd zmssdReference(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                     const PlanarPose& pose, const CostSettings& settings);

/// Defined cells of an aerial map as plain arrays, relative to a reference point.
struct AerialCells {
  std::vector<float> x, y;  ///< centre of the cell minus the reference point [m]
  std::vector<float> h;     ///< height minus mean_height [m]
  double mean_height = 0;   ///< [m]
  Eigen::Vector2d reference = Eigen::Vector2d::Zero();  ///< in the aerial frame [m]
};
AerialCells aerialCells(const HeightMap& air, const Eigen::Vector2d& reference);

/// Ground map prepared for fast evaluation at arbitrary poses. Thread-safe once built.
class DirectCost {
 public:
  /// Throws std::invalid_argument for a map without a single defined cell.
  explicit DirectCost(const HeightMap& ground);

  Zmssd operator()(const AerialCells& cells, const PlanarPose& pose, const CostSettings& settings) const;

  /// Many poses at once (OpenMP).
  std::vector<Zmssd> operator()(const AerialCells& cells, const std::vector<PlanarPose>& poses,
                                const CostSettings& settings) const;

  /// Standard deviation of the aerial heights [m] over the overlap, and of the ground heights there.
  struct Relief {
    double air = 0, ground = 0;
  };
  Relief relief(const AerialCells& cells, const PlanarPose& pose) const;

  /// Centre of the overlap [m], ground frame; the pose's own position when nothing overlaps.
  Eigen::Vector2d overlapCenter(const AerialCells& cells, const PlanarPose& pose) const;

 private:
  /// Ground height (minus mean) of the cell under a point, NaN for holes and outside.
  float groundAt(double x, double y) const;

  double resolution_, origin_x_, origin_y_, mean_;
  double defined_ = 0;           // cells with a height
  int width_, height_;           // with a border of one hole
  std::vector<float> heights_;   // minus mean_
};

}  // namespace heightmap_mcl
