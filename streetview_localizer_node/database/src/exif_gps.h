// What GDAL does not tell of a photograph's EXIF.
#pragma once

#include <cstdint>
#include <set>
#include <string>

namespace streetview_localizer {

/// Tags of EXIF's GPS directory.
enum GpsTag : std::uint16_t { kGpsLatitude = 2, kGpsLongitude = 4, kGpsAltitude = 6, kGpsImageDirection = 17 };

/// Tags of the GPS directory of a JPEG whose rationals are over zero, which GDAL reads as 0. Empty for any other file.
std::set<std::uint16_t> gpsTagsOverZero(const std::string& path);

}  // namespace streetview_localizer
