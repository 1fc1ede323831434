// How surely the heights fix a place.
#pragma once

#include "air_ground_common/geometry.h"
#include "ground_model.h"
#include "heightmap_mcl/coarse_estimate.h"
#include "heightmap_mcl/particle_filter.h"
#include "place_search.h"

namespace heightmap_mcl {

/// See CoarseEstimate::covariance: at the cells' reference, for a place with that verdict. `particles`: their dominant
/// mode; `mav`: the MAV's position that they are of, in the aerial frame [m].
air_ground_common::Matrix6d covarianceOf(const FoundPlace& place, const PlaceMeasures& measures, Status status,
                                         const GroundModel& ground, const ParticleMode& particles,
                                         const Eigen::Vector2d& mav, const HeightMapLocalizerSettings& settings);

}  // namespace heightmap_mcl
