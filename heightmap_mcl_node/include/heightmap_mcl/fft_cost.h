// Equation 2 for every offset of one heading at once, by FFT: nine transforms (eleven and two for every level of
// bounds that occurs) instead of overlap times offsets operations, and six or eight more for the opposite heading.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "heightmap_mcl/height_map.h"
#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl {

/// Costs of placing the aerial map, turned to one heading, at every offset. Row-major.
struct CostMap {
  double resolution = 0;  ///< [m]
  double x0 = 0, y0 = 0;  ///< position of the pivot in the ground frame for cell (0, 0) [m]
  double yaw = 0;         ///< heading of the aerial frame [rad]
  int width = 0, height = 0;
  std::vector<float> cost;  ///< Zmssd::score (eq. 2 when unknown_cost is 0) [m^2]; infinite below the overlap threshold

  float at(int row, int column) const { return cost[static_cast<std::size_t>(row) * width + column]; }
  /// The pose that a cell stands for; its reference point is the pivot of the search.
  PlanarPose pose(int row, int column) const { return {x0 + column * resolution, y0 + row * resolution, yaw}; }
};

/// Smallest product of powers of 2, 3 and 5 that is not below n.
int fiveSmoothSize(int n);

/// Of padded transforms, in cells.
struct FftSize {
  int rows = 0, columns = 0;
};

/// Keeps the transforms of one ground map; thread-safe.
///
/// With M the masks of defined cells, a and g the heights (centred, zero in holes), d = a - g:
///   N = F^-1[conj(A0) G0],  S1 = sum d = F^-1[conj(A1) G0 - conj(A0) G1],
///   S2 = sum d^2 = F^-1[conj(A2) G0 + conj(A0) G2 - 2 conj(A1) G1],  C = (S2 - S1^2/N) / (2 N)    (eq. 2)
/// and likewise the sums of a, a^2, g and g^2 for the variance of either map in the overlap.
/// With bounds (zmssd.h): B_k the masks of the bounds at level b_k, R_k = max(0, b_k - h)^2 of the cells with a height,
///   S2 += sum over k of F^-1[conj(F R_k(a)) F B_k(g) + conj(F B_k(a)) F R_k(g)],
/// the other sums with C over both kinds of cells, N with a count of those that have a height in both.
class FftCost {
 public:
  /// Throws std::invalid_argument for a map without a defined cell.
  explicit FftCost(const HeightMap& ground);
  ~FftCost();
  FftCost(FftCost&&) noexcept;
  FftCost& operator=(FftCost&&) noexcept;

  /// What the aerial map's defined cells need where offsets with less than the least overlap may fall on each other.
  FftSize sizeFor(const HeightMap& turned, const CostSettings& settings) const;
  /// `turned`: aerial map about its pivot, as from rotateAbout, of the ground map's resolution (else
  /// std::invalid_argument). All offsets with any overlap are covered: width = ground width + aerial width - 1.
  /// The error is that of single precision, about 2e-5 of the largest cost. `least`: of several maps that share the
  /// transforms of the ground map.
  CostMap operator()(const HeightMap& turned, double yaw, const CostSettings& settings,
                     const FftSize& least = {}) const;
  /// The same, and for the aerial map turned about its pivot by another half turn, whose transforms are the same but
  /// for their sign.
  std::array<CostMap, 2> andOpposite(const HeightMap& turned, double yaw, const CostSettings& settings,
                                     const FftSize& least = {}) const;

 private:
  void compute(const HeightMap& turned, double yaw, const CostSettings& settings, const FftSize& least, int ways,
               CostMap* maps) const;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace heightmap_mcl
