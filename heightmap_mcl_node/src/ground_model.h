// The ground map as aerial maps are compared with it.
#pragma once

#include <algorithm>
#include <map>
#include <memory>

#include "heightmap_mcl/fft_cost.h"
#include "heightmap_mcl/localizer_settings.h"
#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl {

/// One ground map, its costs, and itself in larger cells. What is slow and not always needed is made when it is first
/// asked for. Not thread-safe.
class GroundModel {
 public:
  struct Level {
    explicit Level(HeightMap larger_cells);
    /// Of every offset.
    const FftCost& fft();

    HeightMap map;
    DirectCost direct;

   private:
    std::unique_ptr<FftCost> fft_;
  };

  /// Throws std::invalid_argument for a map without a defined cell.
  GroundModel(HeightMap map, const HeightMapLocalizerSettings& settings);

  const HeightMap& map() const { return map_; }
  const DirectCost& direct() const { return direct_; }
  const FftCost& fullFft();
  /// Cells of the map's longer edge.
  int edge() const { return std::max(map_.width, map_.height); }
  double extent() const { return edge() * map_.resolution; }  ///< longer edge [m]
  double variance() const { return variance_; }               ///< of the heights [m^2]
  double raised() const { return raised_; }                   ///< see raisedShare

  /// Of cells `factor` times as large.
  Level& level(int factor);
  /// Factor of cells of which at most `most` lie along an edge of so many; coarse_factor at least.
  int factorFor(int edge, int most) const;
  /// That of the search over all placements and scales.
  int largeFactor() const;
  /// Area over which heights are alike [m^2].
  double piece();

 private:
  HeightMap map_;
  DirectCost direct_;
  std::unique_ptr<FftCost> full_fft_;
  int coarse_factor_;
  double variance_, raised_;
  std::map<int, std::unique_ptr<Level>> levels_;  // by factor
  double piece_ = 0;                              // 0: not known yet
};

}  // namespace heightmap_mcl
