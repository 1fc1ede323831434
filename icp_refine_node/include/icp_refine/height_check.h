// A check of an alignment beyond its own residuals: what one robot saw must not lie in space that the other saw
// through.
#pragma once

#include <limits>
#include <optional>

#include "icp_refine/cloud.h"

namespace icp_refine {

struct HeightCheckSettings {
  double cell = 0.06;          ///< [m]
  double tolerance_xy = 0.12;  ///< heights are compared with the best cell within this distance [m]
  double tolerance_z = 0.10;   ///< [m]
  double relief = 0.12;        ///< cells farther than this from the floor's height carry information [m]
  int min_relief_cells = 40;   ///< with fewer the check says nothing
};

struct HeightCheck {
  int aerial_cells = 0;  ///< columns that the aerial cloud observed
  int cells = 0;         ///< of them, observed by the ground robot too
  /// Of them, off the floor in one of the clouds, where the other would show it: the rest speaks for nobody.
  int relief_cells = 0;
  int contradictions = 0;   ///< relief cells where one cloud has a surface in the other's free space
  bool conclusive = false;  ///< enough relief cells
  /// Share of the aerial map that overlaps the ground map, by columns.
  double overlap() const { return aerial_cells ? static_cast<double>(cells) / aerial_cells : 0.0; }
  /// Share of the relief cells without contradiction; 1 when there are none.
  double agreement() const { return relief_cells ? 1.0 - static_cast<double>(contradictions) / relief_cells : 1.0; }
};

/// Both clouds in one gravity-aligned frame. The floor is level at the ground map's most frequent height, or the slope
/// that clearly more of it lies on. The highest point of each column is compared:
/// - a ground point clearly above the aerial surface: the aerial camera, looking down, would have seen it, unless an
/// aerial column beside it was not seen (a wall that the image cut). Contradiction.
/// - an aerial surface clearly above a place where the ground robot saw the floor: seen from above it would have hidden
/// it. Contradiction; but a surface higher than `ground_camera` (z of the ground robot's camera [m]; infinite: not
/// known) may be a table, under which that camera looked, and says nothing.
/// - an aerial surface above the ground robot's view of a steep face: no contradiction, its top may be above the
/// camera.
HeightCheck checkHeights(const Cloud& aerial, const Cloud& ground, const HeightCheckSettings& settings = {},
                         double ground_camera = std::numeric_limits<double>::infinity());

/// Median of ground minus aerial height over the columns that both saw [m]; empty with fewer than 50 of them.
std::optional<double> heightOffset(const Cloud& aerial, const Cloud& ground, double cell);

/// Mask of the aerial points (in the ground map's frame) with a ground point within about `margin` [m], heights aside:
/// the rest cannot match anything.
std::vector<char> nearGroundMap(const Cloud& aerial, const Cloud& ground, double margin);

}  // namespace icp_refine
