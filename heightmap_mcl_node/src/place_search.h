// The places of merged aerial maps in the ground map, over all headings and offsets.
#pragma once

#include <limits>
#include <optional>
#include <vector>

#include "comparison.h"
#include "heightmap_mcl/global_search.h"

namespace heightmap_mcl {

/// Where the floor of the merged maps is: chosen by the best placement of each that the maps allow.
struct FloorChoice {
  double floor = std::numeric_limits<double>::quiet_NaN();  ///< [m]; NaN: as merged, nothing else is possible
  std::vector<Placement> rivals;     ///< the best placements with other floors, of the map's centre
  std::optional<CostVolume> volume;  ///< with this floor, where it was computed
};

struct FoundPlace {
  AerialCells cells;     ///< of the merged maps, about the middle of the overlap
  CostSettings cost;     ///< that they were compared with
  Placement best;        ///< of the cells' reference, as all placements here
  Placement rival;       ///< the best elsewhere; without a finite score where there is none
  PlanarPose particles;  ///< mean of their dominant mode
};

/// What may be a place besides what the search over coarse cells finds.
struct PlaceHints {
  PlanarPose particles;                                    ///< mean of their dominant mode, of the map's centre
  std::optional<air_ground_common::Pose> T_ground_before;  ///< T_ground_mav that was the best one for earlier maps
  std::vector<Placement> others;                           ///< of the map's centre
};

/// Holds references: not to be kept.
class PlaceSearch {
 public:
  PlaceSearch(const HeightMapLocalizerSettings& settings, GroundModel& ground, const Prior& prior,
              const Comparison& comparison)
      : settings_(settings), ground_(ground), prior_(prior), comparison_(comparison) {}

  /// In cells that are coarse_factor times as large, of large maps more.
  CostVolume volumeOf(const HeightMap& air) const;
  /// `merged`: on its own floor.
  FloorChoice chooseFloor(const HeightMap& merged) const;
  /// The best of all places and its best rival. Sought about the map's centre, compared about that of the overlap,
  /// where heading and position hardly interact. `volume`: of the map. Empty where the prior allows no place.
  std::optional<FoundPlace> find(const HeightMap& map, const CostVolume& volume, const PlaceHints& hints) const;

 private:
  std::vector<Placement> placesOf(const CostVolume& volume, std::size_t count, const AerialCells& cells,
                                  const CostSettings& cost) const;
  Placement bestPlacement(const HeightMap& map, const CostVolume& volume) const;
  Placement bestAtParticles(const PlanarPose& mean, const AerialCells& cells, const CostSettings& cost) const;
  std::vector<Placement> allowedPlaces(const CostVolume& volume, const PlaceHints& hints, const AerialCells& cells,
                                       const CostSettings& cost) const;
  Eigen::Vector2d overlapCenter(const AerialCells& cells, const PlanarPose& pose) const;

  const HeightMapLocalizerSettings& settings_;
  GroundModel& ground_;
  const Prior& prior_;
  Comparison comparison_;
};

}  // namespace heightmap_mcl
