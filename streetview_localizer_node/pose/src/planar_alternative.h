// The second pose of a plane (Schweighofer and Pinz 2006; Collins and Bartoli, IPPE, 2014) and the evidence for either.
#pragma once

#include <vector>

#include "robust_search.h"

namespace streetview_localizer::detail {

/// Positions of the inliers on each wall: normals within 15 degrees, offsets within 0.5 m; largest first. Points
/// without a normal form no wall.
std::vector<std::vector<int>> wallsOf(const Matches& matches, const std::vector<int>& inliers);

/// Poses other than `pose` to which the inliers, or those of the largest wall, converge from IPPE's two solutions.
std::vector<Pose> planarAlternatives(const Matches& matches, const Pose& pose, const std::vector<int>& inliers,
                                     double noise, const PosePrior& prior, const PoseSettings& settings);

/// ln of the likelihood of `a` over that of `b`, from the matches that either explains and all that is known
/// beforehand.
double logLikelihoodRatio(const Matches& matches, const Pose& a, const Pose& b, const PosePrior& prior,
                          const PoseSettings& settings);

}  // namespace streetview_localizer::detail
