#include "comparison.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "air_ground_common/units.h"
#include "heightmap_mcl/global_search.h"

namespace heightmap_mcl {

double separation(const PlanarPose& a, const PlanarPose& b) { return std::hypot(a.x - b.x, a.y - b.y); }

bool isSame(const PlanarPose& a, const PlanarPose& b, const RivalSettings& rival) {
  return separation(a, b) < rival.distance && std::abs(air_ground_common::wrapAngle(a.yaw - b.yaw)) < rival.angle;
}

Placement bestElsewhere(const std::vector<Placement>& places, const PlanarPose& pose, const RivalSettings& rival) {
  std::vector<Placement> others;
  std::copy_if(places.begin(), places.end(), std::back_inserter(others),
               [&](const Placement& place) { return !isSame(place.pose, pose, rival); });
  return bestOf(others);
}

double rivalRatio(const Agreement& other, const Agreement& best, double noise_cost) {
  // What both are charged for unknown cells says nothing about either.
  const double cost = best.cost + noise_cost;
  return std::max(0.0, cost + other.score - best.score) / cost;
}

double independentMeasurements(const Agreement& place, const HeightMapLocalizerSettings& settings) {
  const double cell = settings.ground_map.resolution;
  return std::max(place.overlap / (settings.independent_area / (cell * cell)), 1.0);
}

double logLikelihoodRatio(double independent, double cost_less, double cutoff) {
  const double sigma = kHeightDeviation * cutoff;
  return independent * cost_less / (2 * sigma * sigma);
}

CostSettings Comparison::costFor(const HeightMap& air) const {
  const HeightMapLocalizerSettings& s = settings_;
  // Of unrelated heights, eq. 2 is on average half the sum of both variances.
  const double unrelated = 0.5 * (std::pow(heightDeviation(air), 2) + ground_.variance());
  // The paper's share is of one cloud: what other clouds saw elsewhere takes nothing from what this one shares.
  const double smaller = static_cast<double>(std::min(air.defined(), ground_.map().defined()));
  return {s.min_overlap * std::min(1.0, largest_cloud_ / std::max(smaller, 1.0)),
          s.unknown_weight * unrelated,
          s.min_explained,
          s.verdict.min_relief,
          s.overlap_of_air,
          s.cutoff,
          unknownShare()};
}

AerialCells Comparison::cellsOf(const HeightMap& air, const Eigen::Vector2d& reference) const {
  return aerialCells(air, reference, static_cast<int>(std::lround(settings_.edge_width / air.resolution)));
}

double Comparison::unknownShare() const {
  // Two unrelated cells differ where one of them has something on it. Below the least, chosen on scenes of a few boxes,
  // places hide what stands there in the other map's holes.
  constexpr double kLeast = 0.15, kMost = 0.5;
  if (own_unit_) return kMost;  // scales are told apart better: a map of the wrong size has fewer partners
  return std::clamp(ground_.raised() * (2 - ground_.raised()), kLeast, kMost);
}

double Comparison::nothingKnown() const { return unknownShare() * settings_.cutoff * settings_.cutoff; }

double Comparison::scoreElsewhere(const Agreement& rival) const {
  return std::isfinite(rival.score) ? rival.score : nothingKnown();
}

double Comparison::lead(const Agreement& best, const Agreement& rival) const {
  if (!std::isfinite(best.score)) return 0;
  double less = scoreElsewhere(rival) - best.score;
  if (std::isfinite(rival.cost)) {
    // Of equal things a robot sees more of one than of the other: that so much falls into holes there and not here
    // contradicts nothing.
    constexpr double kHidden = 0.05;  // of the smaller map's cells
    less -= std::clamp(less - (rival.cost - best.cost), 0.0, kHidden * nothingKnown());
  }
  return logLikelihoodRatio(independentMeasurements(best, settings_), less, settings_.cutoff);
}

}  // namespace heightmap_mcl
