// The estimate as in Forster 2013: the mean of the particles, believed where they have gathered.
#pragma once

#include "heightmap_mcl/coarse_estimate.h"
#include "heightmap_mcl/localizer_settings.h"

namespace heightmap_mcl {

/// Fills pose, verdict and covariance of an estimate whose statistics of the particles and number of maps are known.
/// `map`: the aerial map that weighs the particles; `mav`: the MAV's position that they are of, in its frame [m].
void estimateFromParticles(const HeightMap& map, const Eigen::Vector2d& mav, const DirectCost& direct,
                           const CostSettings& cost, const HeightMapLocalizerSettings& settings,
                           CoarseEstimate* estimate);

}  // namespace heightmap_mcl
