// The scale of the aerial clouds, for a MAV whose odometry has none: a logarithmic grid, coarse to fine.
#pragma once

#include <limits>
#include <optional>
#include <vector>

#include "scale_trial.h"

namespace heightmap_mcl {

struct ScaleEstimate {
  double value = 1;     ///< [m per unit]
  double stddev = 0;    ///< of it; 0 until it was searched for
  double evidence = 0;  ///< see CoarseEstimate::scale_evidence
};

/// Remembers the last grid's best scales, so that the whole grid is searched less and less often.
class ScaleSearch {
 public:
  explicit ScaleSearch(const HeightMapLocalizerSettings& settings) : settings_(settings) {}

  void clear() { *this = ScaleSearch(settings_); }
  const ScaleEstimate& estimate() const { return estimate_; }

  /// Over all scales, or around the present one where `converged`, T_ground_mav of an estimate to be trusted, is given.
  /// The estimate stays as it was (but for its evidence) where nothing fits.
  void update(const KeptMaps& maps, GroundModel& ground, const Prior& prior, const Comparison& comparison,
              const std::optional<air_ground_common::Pose>& converged);

 private:
  std::vector<double> scalesToTry(double extent, const GroundModel& ground);
  ScaleTrial bestOfScales(const ScaleTrials& trials, const LevelCloud& cloud, const GroundModel& ground);
  void setEvidence(const ScaleTrial& best, const std::vector<ScaleTrial>& refined);
  bool isAlike(const ScaleTrial& a, const ScaleTrial& b) const;
  void refine(ScaleTrial* trial, const ScaleTrials& trials, const LevelCloud& cloud, double step) const;
  void settle(ScaleTrial* trial, const ScaleTrials& trials, const LevelCloud& cloud) const;
  double fit(const ScaleTrial& trial) const { return fitOf(trial, settings_.noise_cost); }
  double chargedFit(const ScaleTrial& trial) const { return fitOf(trial, settings_.noise_cost, true); }

  HeightMapLocalizerSettings settings_;
  ScaleEstimate estimate_;
  double floor_ = std::numeric_limits<double>::quiet_NaN();  // see PlaceOnFloor
  std::vector<double> peaks_;                                // the last grid's best scales
  int grids_ = 0, clouds_since_grid_ = 0;
};

}  // namespace heightmap_mcl
