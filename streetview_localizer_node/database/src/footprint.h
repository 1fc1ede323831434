// Plan of a building, for the map layer.
#pragma once

#include <ogr_geometry.h>

#include <memory>
#include <vector>

#include "streetview_localizer/city_model.h"

namespace streetview_localizer {

/// Multipolygon, in the model's system, that the given triangles cover in plan; a thin strip for a building of walls
/// alone.
std::unique_ptr<OGRGeometry> footprint(const CityModel& model, const std::vector<int>& triangles);

}  // namespace streetview_localizer
