// What both maps say at a place that was found.
#pragma once

#include "ground_model.h"
#include "heightmap_mcl/coarse_estimate.h"
#include "place_search.h"

namespace heightmap_mcl {

/// Fills what the maps tell of `measures`, and particles_agree; of a place without enough overlap only how it compares
/// with its rival. Evidence, spreads and counts are others' to fill.
void measure(const FoundPlace& found, const GroundModel& ground, const Comparison& comparison,
             const HeightMapLocalizerSettings& settings, PlaceMeasures* measures);

}  // namespace heightmap_mcl
