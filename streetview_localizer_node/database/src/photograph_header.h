// What lists of geotags and photographs' own headers share.
#pragma once

#include "streetview_localizer/geotags.h"

namespace streetview_localizer {

/// Notes what cannot be used of a geotag, and which of height and heading (NaN) are not known; these become 0.
void checkGeotag(Geotag* geotag);

}  // namespace streetview_localizer
