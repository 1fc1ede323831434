// Which floor the aerial maps stand on, and how much speaks for a place.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

void HeightMapLocalizer::updateFloor() {
  constexpr std::size_t kMost = 4;
  floor_ = std::numeric_limits<double>::quiet_NaN();
  floor_rivals_.clear();
  if (settings_.mode == Mode::kPaper || aerial_.empty()) return;
  const HeightMap raw = merge(keptMaps(settings_.verify), settings_.merge);
  const std::vector<double> floors = floorCandidates(raw.levels, ground_.levels, ground_.cap, kMost);
  if (floors.size() < 2) return;
  std::vector<Candidate> placements;
  for (const double floor : floors) placements.push_back(bestPlacement(withFloor(raw, floor)));
  std::size_t best = 0;
  for (std::size_t i = 1; i < placements.size(); ++i) {
    if (placements[i].zmssd.score < placements[best].zmssd.score) best = i;
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

double HeightMapLocalizer::rivalRatio(const Zmssd& other, const Zmssd& best) const {
  // What both are charged for unknown cells says nothing about either.
  const double cost = best.cost + settings_.noise_cost;
  const double by_score = std::max(0.0, cost + other.score - best.score) / cost;
  // Of two bare floors there is nothing to explain.
  if (!std::isfinite(other.cost) || std::min(other.relief_air, other.relief_ground) < settings_.min_relief)
    return by_score;
  // The ratio of the shares left unexplained where both overlap as much; what explains less ground counts for less.
  const double independent = std::max(best.overlap / settings_.cells_per_independent, 1.0);
  return std::min(by_score, std::exp(2 * (evidence(best) - evidence(other)) / independent));
}

Candidate HeightMapLocalizer::bestPlacement(const HeightMap& map) const {
  const AerialCells cells = cellsOf(map, centerOf(map));
  const CostSettings cost = costFor(map);
  return bestOfMinima(coarseVolume(map), 3, settings_.rival_distance, settings_.rival_angle, *direct_, cells,
                      settings_.coarse_factor * ground_.resolution, M_PI / settings_.headings, cost);
}

double HeightMapLocalizer::evidence(const Zmssd& z) const {
  if (!std::isfinite(z.cost)) return 0;
  const double unexplained = 2 * (z.cost + settings_.noise_cost) / z.variance;
  return std::max(0.0, -0.5 * z.overlap / settings_.cells_per_independent * std::log(unexplained));
}

bool HeightMapLocalizer::toldApart() const {
  return estimate_.relief >= settings_.min_relief && estimate_.rival_ratio >= settings_.ambiguity_ratio &&
         estimate_.explained >= settings_.min_explained;
}

void HeightMapLocalizer::gatherEvidence() {
  const HeightMapLocalizerSettings& s = settings_;
  const auto place = [this](const air_ground_common::Pose& T) {
    return PlanarPose{(T * inMetres(aerial_.back().reference)).x(), (T * inMetres(aerial_.back().reference)).y(),
                      air_ground_common::yawOf(T.rotation())};
  };
  const PlanarPose now = place(estimate_.T_ground_mav), before = place(evidence_pose_);
  if (std::hypot(now.x - before.x, now.y - before.y) > settings_.rival_distance ||
      std::abs(air_ground_common::wrapAngle(now.yaw - before.yaw)) > settings_.rival_angle) {
    evidence_ = guess_evidence_ = 0;
  }
  evidence_pose_ = estimate_.T_ground_mav;
  if (new_map_) {
    const auto sum = [&](double before, double probe_ratio) {
      const double most = s.min_evidence / 2;
      const bool in_favour = toldApart() && estimate_.probe_ratio >= probe_ratio;
      return std::clamp(before + std::clamp(estimate_.evidence_lead, -most, in_favour ? most : 0.0), 0.0,
                        2 * s.min_evidence);
    };
    evidence_ = sum(evidence_, s.probe_ratio);
    guess_evidence_ = sum(guess_evidence_, s.guess_probe_ratio);
  }
  estimate_.evidence = evidence_;
}

}  // namespace heightmap_mcl
