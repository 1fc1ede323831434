// How much speaks for one place over the maps that had it as their best: a cumulative sum (Page 1954).
#pragma once

#include <Eigen/Core>
#include <optional>

#include "air_ground_common/geometry.h"
#include "heightmap_mcl/localizer_settings.h"

namespace heightmap_mcl {

class EvidenceSum {
 public:
  /// `enough`: sum that is asked for. One map counts for at most half of it either way, and the sum stays within
  /// [0, 2 enough].
  EvidenceSum(double enough, const RivalSettings& rival) : enough_(enough), rival_(rival) {}

  void clear() { *this = EvidenceSum(enough_, rival_); }

  /// The best place as it is now. Both sums begin anew where it is another one than before, compared at `reference`, a
  /// point of mav_map [m].
  void placeAt(const air_ground_common::Pose& T_ground_mav, const Eigen::Vector2d& reference);
  /// Logarithm of how much likelier a new map is at this place than at any other. It counts against the place in any
  /// case; in its favour for CONVERGED or for a guess alone where the map can speak for these.
  void add(double lead, bool speaks_for, bool speaks_for_guess);

  double sum() const { return sum_; }
  double guessSum() const { return guess_sum_; }
  /// T_ground_mav at the last call of placeAt.
  const std::optional<air_ground_common::Pose>& place() const { return place_; }

 private:
  double added(double before, double lead, bool in_favour) const;

  double enough_;
  RivalSettings rival_;
  double sum_ = 0, guess_sum_ = 0;
  std::optional<air_ground_common::Pose> place_;
};

}  // namespace heightmap_mcl
