#include "evidence_sum.h"

#include <algorithm>

#include "comparison.h"

namespace heightmap_mcl {

void EvidenceSum::placeAt(const air_ground_common::Pose& T_ground_mav, const Eigen::Vector2d& reference) {
  if (!place_ || !isSame(planarOf(T_ground_mav, reference), planarOf(*place_, reference), rival_)) {
    sum_ = guess_sum_ = 0;
  }
  place_ = T_ground_mav;
}

void EvidenceSum::add(double lead, bool speaks_for, bool speaks_for_guess) {
  sum_ = added(sum_, lead, speaks_for);
  guess_sum_ = added(guess_sum_, lead, speaks_for_guess);
}

double EvidenceSum::added(double before, double lead, bool in_favour) const {
  const double most = enough_ / 2;
  return std::clamp(before + std::clamp(lead, -most, in_favour ? most : 0.0), 0.0, 2 * enough_);
}

}  // namespace heightmap_mcl
