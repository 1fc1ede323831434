// The second pose of a plane (Schweighofer and Pinz 2006; Collins and Bartoli, IPPE, 2014) and the evidence for either.
#pragma once

#include <vector>

#include "robust_search.h"

namespace streetview_localizer::detail {

/// Errors of neighbouring points are alike (relief that the model lacks, one bad wall), so a crowd of matches counts as
/// no more measurements than this. Calibrated: docs/streetview_pose.md.
constexpr double kEffectiveMeasurements = 80;

/// Positions of the inliers on each wall: normals within 15 degrees, offsets within `tolerance` [m]; largest first.
/// Points without a normal form no wall.
std::vector<std::vector<int>> wallsOf(const Matches& matches, const std::vector<int>& inliers, double tolerance = 0.5);

/// Poses other than `pose` to which the inliers, or those of the largest wall, converge from IPPE's two solutions.
std::vector<Pose> planarAlternatives(const Matches& matches, const Pose& pose, const std::vector<int>& inliers,
                                     double noise, const PosePrior& prior, const PoseSettings& settings);

/// ln of the likelihood of `a` over that of `b`, from the matches that either explains and all that is known
/// beforehand.
double logLikelihoodRatio(const Matches& matches, const Pose& a, const Pose& b, const PosePrior& prior,
                          const PoseSettings& settings);

}  // namespace streetview_localizer::detail
