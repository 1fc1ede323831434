// The rows and columns of a map that hold its defined cells.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

#include "heightmap_mcl/height_map.h"

namespace heightmap_mcl {

/// Both ends belong to it.
struct CellBox {
  int r0, r1, c0, c1;
};

/// Empty for a map without a defined cell.
inline std::optional<CellBox> definedBox(const HeightMap& map) {
  CellBox box{map.height, -1, map.width, -1};
  for (int r = 0; r < map.height; ++r) {
    for (int c = 0; c < map.width; ++c) {
      if (std::isnan(map.at(r, c))) continue;
      box.r0 = std::min(box.r0, r);
      box.r1 = std::max(box.r1, r);
      box.c0 = std::min(box.c0, c);
      box.c1 = std::max(box.c1, c);
    }
  }
  if (box.r1 < 0) return std::nullopt;
  return box;
}

}  // namespace heightmap_mcl
