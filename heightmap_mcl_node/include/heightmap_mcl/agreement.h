// How much of two height maps agrees at a placement, whatever the rest of them says.
//
// Eq. 2 squares what one of the maps cannot know: a side that was never seen, the smear beside a wall, a rim that
// drifted. A few such cells move its minimum by decimetres and degrees, and make a wrong place as good as the right
// one. Here a residual beyond CostSettings::cutoff costs as much as one of the cutoff (truncated least squares; MSAC,
// Torr and Zisserman 2000). Residuals are those of zmssd.h, but that what lifts the aerial map is the mean of the
// heights that agree. Needs a start near the minimum: that is what the search over eq. 2 is for.
#pragma once

#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl {

/// Shares of CostSettings::cutoff: standard deviation of the heights of one place in two maps; residual up to which
/// they agree; height above the floor from which a cell has something on it.
constexpr double kHeightDeviation = 0.3, kAgreeing = 0.6, kRaised = 0.8;

struct Agreement {
  int overlap = 0;          ///< cells defined in both maps, bounds included
  double cost = kInfinity;  ///< mean of min(r, cutoff)^2 over them [m^2]; infinite below CostSettings::min_overlap
  /// cost, where cells of the smaller map without a partner cost CostSettings::unknown_share of the most [m^2]: what
  /// placements are compared by.
  double score = kInfinity;
  int raised = 0;       ///< partners of which at least one stands above the floor for certain
  double agreeing = 0;  ///< share of these whose heights agree: what is bare in both maps tells nothing
  double offset = 0;    ///< mean of aerial minus ground height, both above base, where they agree within the cutoff [m]
  double dz = 0;        ///< what lifts the aerial map by that [m]
};

/// Reference: double precision, one cell after the other, as zmssdReference. `offset`: of the aerial heights, both
/// above base [m].
Agreement agreementReference(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                             const PlanarPose& pose, double offset, const CostSettings& settings, int edge = 0);

/// A placement and what agrees there.
struct Placement {
  PlanarPose pose;  ///< of the reference point of the cells it was computed with
  Agreement agreement;
};

/// The placement as it is: the offset from the median of the differences, then the mean of what agrees with it.
Placement placementAt(const DirectCost& cost, const AerialCells& cells, const PlanarPose& pose,
                      const CostSettings& settings);

}  // namespace heightmap_mcl
