// Cells of two height maps that come to lie on each other, one after the other: what the references add up.
#pragma once

#include <utility>
#include <vector>

#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl {

/// Height above base; of a bound that of its level.
struct CellHeight {
  double value = 0;
  bool bound = false;
  double low = 0, high = 0;  ///< what it may be
  bool known() const { return low == high; }
};

/// Aerial and ground height of each cell defined in both maps.
using Partners = std::vector<std::pair<CellHeight, CellHeight>>;
Partners partnersOf(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                    const PlanarPose& pose, int edge);

/// By how much the ranges of what both may be lie apart [m].
inline double lackOf(const CellHeight& a, const CellHeight& g) {
  return std::max({0.0, a.low - g.high, g.low - a.high});
}

}  // namespace heightmap_mcl
