// The cost (agreement.h) around a place: how it curves, and where it is flattest.
#pragma once

#include "heightmap_mcl/agreement.h"

namespace heightmap_mcl {

/// Curvature of the cost in (x, y, yaw) at a placement by central differences of `step` [m^2 per m^2, m rad, rad^2].
/// What unknown cells are charged has no part in it: where the maps end fixes nothing.
Eigen::Matrix3d curvature(const DirectCost& cost, const AerialCells& cells, const Placement& best,
                          const CostSettings& settings, const Eigen::Vector3d& step);

struct Probe {
  double ratio = kInfinity;                            ///< of the cost after the flattest move to that before
  Eigen::Vector3d flattest = Eigen::Vector3d::Zero();  ///< that move: x, y [m], yaw [rad] of the cells' reference
};

/// Tries moves by `distance` [m]: shifts all round, turns about the middle, and the direction of the least curvature.
/// Headings are scaled so that they move the overlap's rim as far as a shift. `noise_cost` is added to both costs
/// [m^2].
Probe probe(const DirectCost& cost, const AerialCells& cells, const Placement& best, const CostSettings& settings,
            double distance, double noise_cost);

}  // namespace heightmap_mcl
