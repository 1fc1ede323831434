// The best place of the aerial clouds at one scale, and what it says for that scale.
#pragma once

#include <limits>

#include "comparison.h"
#include "ground_model.h"
#include "heightmap_mcl/global_search.h"
#include "kept_maps.h"

namespace heightmap_mcl {

struct PlaceOnFloor {
  PlanarPose pose;                                          ///< of the clouds' centre
  double floor = std::numeric_limits<double>::quiet_NaN();  ///< of the aerial map [unit]; NaN: its own lowest surface
};

struct ScaleTrial {
  double scale = 1;     ///< [m per unit]
  PlaceOnFloor place;   ///< the best one
  Agreement agreement;  ///< there
  Zmssd zmssd;
  /// Logarithm of how much likelier the heights of a piece of ground are there than at the best place elsewhere, times
  /// the share that the place explains of what nothing known would cost. At a wrong scale many places fit about as
  /// well, if it is too small, or none does, if it is too large.
  double distinctness = -kInfinity;
  double independent = 1;  ///< pieces of ground whose height both maps know
  double curvature = 0;    ///< of the cost by the logarithm of the scale [m^2], not negative
  double radius = 0;       ///< root mean square distance of the aerial cells from their centre [m]
};

/// How well the heights fit, by piece of ground: a larger map shares more of them, and one with less relief differs by
/// less, which says nothing for either. `charged` for what has no partner, too. Not finite where nothing fits.
double fitOf(const ScaleTrial& trial, double noise_cost, bool charged = false);

/// Curvature of the cost by the logarithm of the scale [m^2], of three trials that are `step` of it apart; 0 where it
/// is not convex or not known.
double bendOf(const ScaleTrial& before, const ScaleTrial& middle, const ScaleTrial& after, double step);

/// Relative standard deviation of the scale: what the heights fix, and that both maps round edges in a way that more of
/// them do not average out: a face is as thick in the ground map as its depths scatter and cells are wide, towards
/// where it was seen from.
double scaleDeviation(const ScaleTrial& trial, double noise_cost);

/// Makes trials in one ground map. Holds references: not to be kept.
class ScaleTrials {
 public:
  ScaleTrials(const HeightMapLocalizerSettings& settings, GroundModel& ground, const Prior& prior,
              const Comparison& comparison)
      : settings_(settings), ground_(ground), prior_(prior), comparison_(comparison) {}

  /// The best placement over all headings, offsets and floors, in large cells.
  ScaleTrial anywhere(double scale, const LevelCloud& cloud) const;
  /// The best placement near that of another scale, in a map of at most so many cells across; whether it stands out is
  /// not asked.
  ScaleTrial near(double scale, const LevelCloud& cloud, int cells_across, const PlaceOnFloor& start) const;

 private:
  struct ScaledMap;
  ScaledMap scaledMap(double scale, const LevelCloud& cloud, int cells_across, int least_factor) const;
  void judge(ScaleTrial* trial, const ScaledMap& map, const HeightMap& lifted, const Agreement& there) const;

  const HeightMapLocalizerSettings& settings_;
  GroundModel& ground_;
  const Prior& prior_;
  const Comparison& comparison_;
};

}  // namespace heightmap_mcl
