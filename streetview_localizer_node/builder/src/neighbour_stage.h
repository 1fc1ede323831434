// The stage of a build that compares corrected poses with what neighbouring images show.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "build_items.h"
#include "streetview_localizer/back_projection.h"

namespace streetview_localizer {

/// Takes the conclusions over into the items' panoramas and the report. `stored`: whether an item is in the database
/// with its views; such a one is a witness, and stays as it is. `tell`: as buildDatabase's progress.
void compareNeighbours(const BuildSettings& settings, const BackProjector& projector,
                       const std::function<bool(const BuildItem&)>& stored,
                       const std::function<void(const std::string&, int, int)>& tell, std::vector<BuildItem>* items,
                       BuildReport* report);

}  // namespace streetview_localizer
