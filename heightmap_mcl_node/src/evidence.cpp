// Which floor the aerial maps stand on, and how much speaks for a place.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

void HeightMapLocalizer::updateFloor() {
  constexpr std::size_t kMost = 4;
  verify_volume_.reset();
  floor_ = std::numeric_limits<double>::quiet_NaN();
  floor_rivals_.clear();
  if (settings_.mode == Mode::kPaper || aerial_.empty()) return;
  const HeightMap raw = merge(keptMaps(settings_.verify), settings_.merge);
  const std::vector<double> floors = floorCandidates(raw.levels, ground_.levels, ground_.cap, kMost);
  if (floors.size() < 2) return;
  std::vector<Placement> placements;
  std::size_t best = 0;
  for (std::size_t i = 0; i < floors.size(); ++i) {
    const HeightMap map = withFloor(raw, floors[i]);
    CostVolume volume = coarseVolume(map);
    placements.push_back(bestPlacement(map, volume));
    if (i > 0 && !(placements[i].agreement.score < placements[best].agreement.score)) continue;
    best = i;
    verify_volume_ = std::move(volume);
  }
  for (std::size_t i = 0; i < placements.size(); ++i) {
    if (i != best) floor_rivals_.push_back(placements[i]);
  }
  floor_ = floors[best];
}

HeightMap HeightMapLocalizer::lastMaps(int count) const {
  HeightMap map = merge(keptMaps(count), settings_.merge);
  return std::isnan(floor_) ? map : withFloor(std::move(map), floor_);
}

double HeightMapLocalizer::rivalRatio(const Agreement& other, const Agreement& best) const {
  // What both are charged for unknown cells says nothing about either.
  const double cost = best.cost + settings_.noise_cost;
  return std::max(0.0, cost + other.score - best.score) / cost;
}

Placement HeightMapLocalizer::bestPlacement(const HeightMap& map, const CostVolume& volume) const {
  const AerialCells cells = cellsOf(map, centerOf(map));
  return bestOf(placesOfMinima(volume, 3, settings_.rival_distance, settings_.rival_angle, *direct_, cells,
                               settings_.coarse_factor * ground_.resolution, M_PI / settings_.headings, costFor(map)));
}

double HeightMapLocalizer::independentCells(const Agreement& place) const {
  return std::max(place.overlap / settings_.cells_per_independent, 1.0);
}

double HeightMapLocalizer::evidenceLead(const Agreement& place, double other_score) const {
  return std::isfinite(place.score) ? logLikelihoodRatio(independentCells(place), other_score - place.score) : 0;
}

double HeightMapLocalizer::logLikelihoodRatio(double independent, double cost_less) const {
  const double sigma = kHeightDeviation * settings_.cutoff;
  return independent * cost_less / (2 * sigma * sigma);
}

double HeightMapLocalizer::unknownShare() const {
  // Two unrelated cells differ where one of them has something on it. Below the least, chosen on scenes of a few boxes,
  // places hide what stands there in the other map's holes.
  constexpr double kLeast = 0.15, kMost = 0.5;
  if (own_unit_) return kMost;  // scales are told apart better: a map of the wrong size has fewer partners
  return std::clamp(ground_raised_ * (2 - ground_raised_), kLeast, kMost);
}

double HeightMapLocalizer::nothingKnown() const { return unknownShare() * settings_.cutoff * settings_.cutoff; }

bool HeightMapLocalizer::toldApart(double agreement, double rival_ratio) const {
  return estimate_.relief >= settings_.min_relief && estimate_.raised >= settings_.min_raised &&
         estimate_.agreement >= agreement && estimate_.rival_ratio >= rival_ratio;
}

bool HeightMapLocalizer::speaksFor() const {
  return estimate_.has_pose && estimate_.probe_ratio >= settings_.probe_ratio &&
         toldApart(settings_.min_agreement, settings_.ambiguity_ratio);
}

bool HeightMapLocalizer::speaksForGuess() const {
  return estimate_.has_pose && estimate_.probe_ratio >= settings_.guess_ratio &&
         toldApart(settings_.guess_agreement, settings_.guess_ratio);
}

bool HeightMapLocalizer::isGuess() const {
  return !own_unit_ && estimate_.status != Status::kConverged && estimate_.maps >= settings_.min_maps &&
         speaksForGuess() && guess_evidence_ >= settings_.min_evidence;
}

void HeightMapLocalizer::gatherEvidence() {
  const HeightMapLocalizerSettings& s = settings_;
  const Eigen::Vector2d reference = lastReference();
  if (!place_before_ || !isSame(planarOf(estimate_.T_ground_mav, reference), planarOf(*place_before_, reference))) {
    evidence_ = guess_evidence_ = 0;
  }
  place_before_ = estimate_.T_ground_mav;
  if (new_map_) {
    const auto sum = [&](double before, bool in_favour) {
      const double most = s.min_evidence / 2;
      return std::clamp(before + std::clamp(estimate_.evidence_lead, -most, in_favour ? most : 0.0), 0.0,
                        2 * s.min_evidence);
    };
    evidence_ = sum(evidence_, speaksFor());
    guess_evidence_ = sum(guess_evidence_, speaksForGuess());
  }
  estimate_.evidence = evidence_;
}

}  // namespace heightmap_mcl
