// A check of an alignment beyond its own residuals: what one robot saw must not lie in space that the other saw
// through.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "icp_refine/cloud.h"

namespace icp_refine {

struct HeightCheckSettings {
  double cell = 0.06;          ///< [m]
  double tolerance_xy = 0.12;  ///< heights are compared with the best cell within this distance [m]
  double tolerance_z = 0.10;   ///< [m]
  double relief = 0.12;        ///< cells farther than this from the floor's height carry information [m]
  int min_relief_cells = 40;   ///< with fewer the check says nothing
  double margin = 0.6;         ///< farther than this from the ground map, in plan, a point is not near() it [m]
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

/// Columns and floor of the ground map, gravity-aligned: made once, for all poses that are tried on it. The floor is
/// level at the map's most frequent height, or the slope that clearly more of it lies on.
class GroundHeights {
 public:
  explicit GroundHeights(const Cloud& ground, const HeightCheckSettings& settings = {});

  /// The aerial cloud is in the ground map's frame, as everywhere here. The highest point of each column is compared:
  /// - a ground point clearly above the aerial surface: the aerial camera, looking down, would have seen it, unless an
  /// aerial column beside it was not seen (a wall that the image cut). Contradiction.
  /// - an aerial surface clearly above a place where the ground robot saw the floor: seen from above it would have
  /// hidden it. Contradiction; but a surface higher than `ground_camera` (z of the ground robot's camera [m]; infinite:
  /// not known) may be a table, under which that camera looked, and says nothing.
  /// - an aerial surface above the ground robot's view of a steep face: no contradiction, its top may be above the
  /// camera.
  HeightCheck check(const Cloud& aerial, double ground_camera = std::numeric_limits<double>::infinity()) const;

  /// Median of ground minus aerial height over the columns that both saw [m]; empty with fewer than 50 of them.
  std::optional<double> offset(const Cloud& aerial) const;

  /// Mask of the aerial points with a ground point within about the margin, heights aside: the rest cannot match
  /// anything.
  std::vector<char> near(const Cloud& aerial) const;

 private:
  struct Maps;
  HeightCheckSettings settings_;
  std::shared_ptr<const Maps> maps_;
};

}  // namespace icp_refine
