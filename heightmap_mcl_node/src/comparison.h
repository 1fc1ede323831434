// What makes one place better than another, and by how much.
#pragma once

#include <vector>

#include "ground_model.h"
#include "heightmap_mcl/agreement.h"
#include "heightmap_mcl/localizer_settings.h"

namespace heightmap_mcl {

/// In plan [m].
double separation(const PlanarPose& a, const PlanarPose& b);
/// Neither is a rival of the other.
bool isSame(const PlanarPose& a, const PlanarPose& b, const RivalSettings& rival);
/// The best one that is not at `pose`; without a finite score where there is none.
Placement bestElsewhere(const std::vector<Placement>& places, const PlanarPose& pose, const RivalSettings& rival);

/// How many times as bad as the best place another one is: the own cost and what the other's score is higher, both with
/// `noise_cost` [m^2].
double rivalRatio(const Agreement& other, const Agreement& best, double noise_cost);

/// Measurements in the overlap that are independent, at least 1.
double independentMeasurements(const Agreement& place, const HeightMapLocalizerSettings& settings);
/// Logarithm of how much likelier heights are whose mean squared residual is less by `cost_less` [m^2], over so many
/// independent measurements. `cutoff`: see agreement.h [m].
double logLikelihoodRatio(double independent, double cost_less, double cutoff);

/// The same of aerial maps and the present ground map. Holds references: not to be kept.
class Comparison {
 public:
  /// `largest_cloud`: defined cells of the largest one of the aerial maps.
  Comparison(const HeightMapLocalizerSettings& settings, const GroundModel& ground, double largest_cloud, bool own_unit)
      : settings_(settings), ground_(ground), largest_cloud_(largest_cloud), own_unit_(own_unit) {}

  CostSettings costFor(const HeightMap& air) const;
  /// Relative to `reference` (aerial frame), edges as wide as the settings say.
  AerialCells cellsOf(const HeightMap& air, const Eigen::Vector2d& reference) const;
  /// Score of the best other place [m^2]; where there is none, that of a placement without partners.
  double scoreElsewhere(const Agreement& rival) const;
  double nothingKnown() const;  ///< score of a placement without partners [m^2]
  /// Logarithm of how much likelier the heights are at the best place than at its best rival.
  double lead(const Agreement& best, const Agreement& rival) const;

 private:
  double unknownShare() const;  // see CostSettings

  const HeightMapLocalizerSettings& settings_;
  const GroundModel& ground_;
  double largest_cloud_;
  bool own_unit_;
};

}  // namespace heightmap_mcl
