// The files of a city model, as one list of polygons in one system.
#pragma once

#include <string>

#include "coordinate_system.h"
#include "polygons.h"

namespace streetview_localizer {

/// All polygons of a file, or of the files of a folder and the folders in it, easting first, heights in metres with
/// height_offset. Notes crs, height_unit, axis_order and identity in `result`. Throws std::runtime_error with one line.
PolygonModel readModelFiles(const std::string& path, const CityModelOptions& options, CityModel* result);

}  // namespace streetview_localizer
