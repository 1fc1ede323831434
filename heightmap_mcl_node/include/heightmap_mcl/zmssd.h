// Zero-mean sum of squared differences of two height maps (Forster 2013, eq. 2), evaluated at single poses.
//
// Where one of two cells is a bound b ("at least so high"), its residual is what is lacking, max(0, b - h) for the
// other one's height h, both above their own floors; two bounds contradict nothing. Such cells are partners like any
// other, but have no part in the mean that eq. 2 takes off. Bounds are rounded down to kBoundLevels levels, which makes
// their sums a few more correlations (fft_cost.h).
//
// The MAV's map draws edges a few cells beside where they are. A cell near one is compared as what it may be: its
// residual is the distance of the ground height from the range of the aerial heights around it.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "air_ground_common/geometry.h"
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
/// What a level T_ground_air makes of a reference point.
PlanarPose planarOf(const air_ground_common::Pose& T_ground_air, const Eigen::Vector2d& reference);

struct CostSettings {
  /// Cells that must be defined in both maps, as a share of the defined cells of the aerial map (paper), or of the
  /// ground map where that is the smaller one, in (0, 1].
  double min_overlap = 0.5;
  /// Charged for cells of the smaller map without a partner [m^2]: score = eq. 2 + unknown_cost * (1 - share * trust),
  /// where share is that of the cells with a partner; 0 = paper. Without it a placement gains by hiding the structure
  /// it cannot explain in the ground map's holes.
  double unknown_cost = 0;
  /// trust = explained / min_explained, within [0, 1] (see Zmssd::explained); 0: 1 throughout. Without it bare floor is
  /// a good place for any structure of little area: eq. 2 is never above half of the structure's own variance there.
  double min_explained = 0;
  double min_relief = 0;        ///< see Zmssd::explained [m]
  bool overlap_of_air = false;  ///< the aerial map counts as the smaller one, whichever is (paper)
  double cutoff = 0.1;          ///< see agreement.h [m]
  double unknown_share = 0.5;   ///< of cutoff^2, likewise

  /// Cells that a full overlap has.
  double cells(double aerial, double ground) const { return overlap_of_air ? aerial : std::min(aerial, ground); }
};

/// Checks ranges; throws std::invalid_argument naming the field.
void validate(const CostSettings& settings);

struct Zmssd {
  int overlap = 0;           ///< cells defined in both maps, bounds included
  int known = 0;             ///< those of them with a height in both, no edge near
  double cost = kInfinity;   ///< eq. 2 [m^2], eta = 1 / (2 overlap); infinite below the overlap threshold
  double score = kInfinity;  ///< what placements are compared by [m^2], see CostSettings::unknown_cost
  double relief_air = 0;     ///< standard deviation of the aerial heights in the overlap [m]
  double relief_ground = 0;  ///< of the ground heights there [m]
  double variance = 0;       ///< of the heights that vary more, at least min_relief^2 [m^2]
  /// 1 - 2 cost / variance: 1 where the maps say the same, 0 where one of them has structure that the other lacks;
  /// below 0 where their structures contradict.
  double explained = 0;
  double dz = 0;  ///< mean of ground minus aerial height over the overlap: what lifts the aerial map [m]
};

/// Sums over the cells defined in both maps: a aerial, g ground heights or bounds, d = a - g where both are heights and
/// no edge is near.
struct OverlapSums {
  double n = 0;
  double known = 0;  ///< cells with a height in both, no edge near
  double d = 0;      ///< over the known ones
  double d2 = 0;     ///< over the known ones, and the squared residuals of bounds and edges
  double a = 0, a2 = 0, g = 0, g2 = 0;
};

/// `cells`: defined cells of the smaller map.
inline Zmssd zmssdFromSums(const OverlapSums& sums, double cells, const CostSettings& settings) {
  Zmssd result;
  const double n = sums.n;
  result.overlap = static_cast<int>(n + 0.5);
  result.known = static_cast<int>(sums.known + 0.5);
  if (n < 1 || n < settings.min_overlap * cells) return result;
  const auto variance = [n](double sum, double squares) { return std::max(0.0, squares / n - sum / n * (sum / n)); };
  const double air = variance(sums.a, sums.a2), ground = variance(sums.g, sums.g2);
  result.relief_air = std::sqrt(air);
  result.relief_ground = std::sqrt(ground);
  const double mean = sums.known > 0.5 ? sums.d / sums.known : 0;
  result.cost = std::max(0.0, sums.d2 - sums.d * mean) / (2 * n);
  result.dz = -mean;
  result.variance = std::max({air, ground, settings.min_relief * settings.min_relief});
  result.explained = result.variance > 0 ? 1 - 2 * result.cost / result.variance : 1;
  const double trust = settings.min_explained > 0 ? std::clamp(result.explained / settings.min_explained, 0.0, 1.0) : 1;
  result.score = result.cost + settings.unknown_cost * (1 - trust * std::min(1.0, n / cells));
  return result;
}

/// Reference: double precision, one cell after the other, nearest ground cell. `pose` places `reference` (aerial
/// frame). `edge`: see aerialCells.
Zmssd zmssdReference(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                     const PlanarPose& pose, const CostSettings& settings, int edge = 0);

/// Defined cells of an aerial map as plain arrays, relative to a reference point.
struct AerialCells {
  std::vector<float> x, y;                              ///< centre of the cell minus the reference point [m]
  std::vector<float> h;                                 ///< height or bound minus base [m]
  std::vector<float> low, high;                         ///< what the height may be [m]: h, but at edges and of bounds
  int weight = 1;                                       ///< cells that each of them stands for
  double base = 0;                                      ///< see baseHeight [m]
  double mean_height = 0;                               ///< [m]
  Eigen::Vector2d reference = Eigen::Vector2d::Zero();  ///< in the aerial frame [m]
};
/// A bound's height above base is that of its level. Cells that have an edge, a step of more than kEdgeStep, within
/// `edge` cells may be as high as anything there; those around which much was not seen, at least so high.
AerialCells aerialCells(const HeightMap& air, const Eigen::Vector2d& reference, int edge = 0);
constexpr double kEdgeStep = 0.1;  // [m]
/// The same cells relative to another point.
AerialCells about(AerialCells cells, const Eigen::Vector2d& reference);
/// Every `stride`th of them.
AerialCells thinned(const AerialCells& cells, int stride);

struct Agreement;

/// Ground map prepared for fast evaluation at arbitrary poses. Thread-safe once built.
class DirectCost {
 public:
  /// Throws std::invalid_argument for a map without a single defined cell.
  explicit DirectCost(const HeightMap& ground);

  Zmssd operator()(const AerialCells& cells, const PlanarPose& pose, const CostSettings& settings) const;

  /// Many poses at once (OpenMP).
  std::vector<Zmssd> operator()(const AerialCells& cells, const std::vector<PlanarPose>& poses,
                                const CostSettings& settings) const;

  /// See agreement.h; `offset` of the aerial heights [m].
  Agreement agreement(const AerialCells& cells, const PlanarPose& pose, double offset,
                      const CostSettings& settings) const;
  /// Median of aerial minus ground height, both above base, over the cells with a height in both [m]; 0 without any.
  double medianOffset(const AerialCells& cells, const PlanarPose& pose) const;

  struct Overlap {
    Eigen::Vector2d center;  ///< in the ground frame [m]; the pose's own position when nothing overlaps
    double radius = 0;       ///< root mean square distance of its cells from there [m]
  };
  Overlap overlapAt(const AerialCells& cells, const PlanarPose& pose) const;

 private:
  /// Ground height (minus base) of the cell under a point, NaN for holes and outside.
  float groundAt(double x, double y) const;

  double resolution_, origin_x_, origin_y_, base_;
  double defined_ = 0;          // cells with a height
  int width_, height_;          // with a border of one hole
  std::vector<float> heights_;  // minus base_; bounds are kernel::kBoundOffset higher
};

}  // namespace heightmap_mcl
