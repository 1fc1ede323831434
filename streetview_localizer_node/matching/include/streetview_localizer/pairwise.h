// Step 4 of the matching: the query's features against those of one view of the database, exactly.
#pragma once

#include <vector>

#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct PairwiseSettings {
  double max_distance = 330;  ///< of the descriptors (the largest possible is 724)
  double max_ratio = 0.85;    ///< of the distance to the best over that to the best at another place of the view
  double place_radius = 8;    ///< keypoints nearer than this are at one place [px]
  bool mutual = true;         ///< the query's feature, or one at its place, must also be the view feature's nearest
};

/// Putative matches, each feature of the view at most once, and no two of one place of the query with one place of the
/// view; in ascending order of the query's index. Runs in OpenMP threads; the result does not depend on their number.
std::vector<Match> matchPairwise(const Features& query, const Features& view, const PairwiseSettings& settings = {});

/// The same, one pair of descriptors after the other: the plain reference.
std::vector<Match> matchPairwiseReference(const Features& query, const Features& view,
                                          const PairwiseSettings& settings = {});

}  // namespace streetview_localizer
