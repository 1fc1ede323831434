// From the points of each cell to its height: the highest one, or the top of a column as far as it was seen.
#pragma once

#include "heightmap_mcl/height_map.h"

namespace heightmap_mcl {

/// Fills heights, bounds, floor and cap of `map`, whose grid is set, and dilates it. `z`: the points' heights [m],
/// those of cell k from begin[k] to before begin[k + 1]; sorted on return. `earlier`: see buildHeightMap.
void fillCells(std::vector<float>& z, const std::vector<int>& begin, const HeightMapSettings& settings,
               const LevelHistogram* earlier, HeightMap& map);

}  // namespace heightmap_mcl
