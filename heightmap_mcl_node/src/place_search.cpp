#include "place_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/units.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::kDegree;

/// Minima of eq. 2 that are compared: the right place is often not its lowest one.
constexpr std::size_t kPlaces = 16;
constexpr std::size_t kPlacesOfFloor = 3;
constexpr std::size_t kFloors = 4;
/// Across the larger of the maps in the search over all places: half a step of the heading moves a large map's rim by
/// far more than one of its cells.
constexpr int kMostCells = 160;

}  // namespace

CostVolume PlaceSearch::volumeOf(const HeightMap& air) const {
  const auto headings = searchHeadings(settings_.headings, prior_);
  const bool circular = static_cast<int>(headings.size()) == settings_.headings;
  const int factor = ground_.factorFor(std::max({ground_.edge(), air.width, air.height}), kMostCells);
  return computeCostVolume(ground_.level(factor).fft(), downsample(air, factor), headings, circular,
                           comparison_.costFor(air));
}

std::vector<Placement> PlaceSearch::placesOf(const CostVolume& volume, std::size_t count, const AerialCells& cells,
                                             const CostSettings& cost) const {
  return placesOfMinima(volume, count, settings_.rival.distance, settings_.rival.angle, prior_, ground_.direct(), cells,
                        volume.slices.front().resolution, M_PI / settings_.headings, cost);
}

Placement PlaceSearch::bestPlacement(const HeightMap& map, const CostVolume& volume) const {
  return bestOf(placesOf(volume, kPlacesOfFloor, comparison_.cellsOf(map, centerOf(map)), comparison_.costFor(map)));
}

FloorChoice PlaceSearch::chooseFloor(const HeightMap& merged) const {
  FloorChoice choice;
  const HeightMap& ground = ground_.map();
  const std::vector<double> floors = floorCandidates(merged.levels, ground.levels, ground.cap, kFloors);
  if (floors.size() < 2) return choice;
  std::vector<Placement> placements;
  std::size_t best = 0;
  for (std::size_t i = 0; i < floors.size(); ++i) {
    const HeightMap map = withFloor(merged, floors[i]);
    CostVolume volume = volumeOf(map);
    placements.push_back(bestPlacement(map, volume));
    if (i > 0 && !(placements[i].agreement.score < placements[best].agreement.score)) continue;
    best = i;
    choice.volume = std::move(volume);
  }
  for (std::size_t i = 0; i < placements.size(); ++i) {
    if (i != best) choice.rivals.push_back(placements[i]);
  }
  choice.floor = floors[best];
  return choice;
}

std::optional<FoundPlace> PlaceSearch::find(const HeightMap& map, const CostVolume& volume,
                                            const PlaceHints& hints) const {
  FoundPlace found;
  found.cells = comparison_.cellsOf(map, centerOf(map));
  found.cost = comparison_.costFor(map);
  std::vector<Placement> places = allowedPlaces(volume, hints, found.cells, found.cost);
  if (places.empty()) return std::nullopt;
  found.best = bestOf(places);
  const Eigen::Vector2d merged_center = found.cells.reference;
  const Eigen::Vector2d overlap_center = overlapCenter(found.cells, found.best.pose);
  found.cells = about(std::move(found.cells), overlap_center);
  const auto recentred = [&](const PlanarPose& pose) {
    return changeReference(pose, merged_center, found.cells.reference);
  };
  for (Placement& place : places) place.pose = recentred(place.pose);
  found.particles = recentred(hints.particles);
  found.best.pose = recentred(found.best.pose);
  const Placement refined =
      descend(ground_.direct(), found.cells, found.best.pose, ground_.map().resolution, kDegree, found.cost);
  if (refined.agreement.score < found.best.agreement.score) found.best = refined;
  found.rival = bestElsewhere(places, found.best.pose, settings_.rival);
  return found;
}

/// Where the particles are, whether it is a minimum or not.
Placement PlaceSearch::bestAtParticles(const PlanarPose& mean, const AerialCells& cells,
                                       const CostSettings& cost) const {
  const Placement best = descend(ground_.direct(), cells, mean, 2 * ground_.map().resolution, 2 * kDegree, cost);
  if (std::isfinite(best.agreement.cost) && !(separation(best.pose, mean) > settings_.rival.distance)) return best;
  return placementAt(ground_.direct(), cells, mean, cost);
}

/// The lowest places of the full search beside those that are hinted at. Where one fits better than the particles' one,
/// it is the estimate, and the particles have yet to follow.
std::vector<Placement> PlaceSearch::allowedPlaces(const CostVolume& volume, const PlaceHints& hints,
                                                  const AerialCells& cells, const CostSettings& cost) const {
  std::vector<Placement> places = placesOf(volume, kPlaces, cells, cost);
  places.push_back(bestAtParticles(hints.particles, cells, cost));
  // Where the maps were before: few new cells may hide that place from the search over coarse ones.
  if (hints.T_ground_before)
    places.push_back(descend(ground_.direct(), cells, planarOf(*hints.T_ground_before, cells.reference),
                             2 * ground_.map().resolution, 2 * kDegree, cost));
  places.insert(places.end(), hints.others.begin(), hints.others.end());
  // Descents may have led out of what is allowed, and what is hinted at may lie there.
  places.erase(std::remove_if(places.begin(), places.end(),
                              [&](const Placement& c) { return !prior_.allows(c.pose, cells.reference); }),
               places.end());
  return places;
}

/// In the aerial frame.
Eigen::Vector2d PlaceSearch::overlapCenter(const AerialCells& cells, const PlanarPose& pose) const {
  const Eigen::Vector2d center = ground_.direct().overlapAt(cells, pose).center;
  return cells.reference + Eigen::Rotation2Dd(-pose.yaw) * (center - Eigen::Vector2d(pose.x, pose.y));
}

}  // namespace heightmap_mcl
