// Which of a file's roads, waters and fields are the ground that cameras stand on.
#pragma once

#include <string>
#include <vector>

#include "polygons.h"

namespace streetview_localizer {

/// Takes out the polygons of each theme (roads, waters ...; not the relief) that in the median lie far above or below
/// the ground around, and says so. The ground is the relief within 50 m of a polygon's corner, or where there is none
/// the foot of the nearest building. `model` in world [m].
void leaveOutStrayGround(PolygonModel* model, std::vector<std::string>* remarks);

}  // namespace streetview_localizer
