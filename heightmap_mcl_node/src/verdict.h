// From what was measured of a place to whether it is believed.
#pragma once

#include <string>

#include "heightmap_mcl/coarse_estimate.h"
#include "heightmap_mcl/localizer_settings.h"

namespace heightmap_mcl {

struct Verdict {
  Status status = Status::kSearching;
  std::string reason;  ///< one line
  bool guess = false;  ///< see VerdictSettings::guess_ratio
};

/// The first thing that speaks against the place decides.
Verdict judge(const PlaceMeasures& place, const VerdictSettings& settings);

/// Whether a map that says so may count in favour of CONVERGED: there is relief, it fixes all directions, what stands
/// on the floor agrees, and nowhere else as well.
bool speaksFor(const PlaceMeasures& place, const VerdictSettings& settings);
/// The same in favour of a guess.
bool speaksForGuess(const PlaceMeasures& place, const VerdictSettings& settings);

}  // namespace heightmap_mcl
