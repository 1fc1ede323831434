// Covariance of a refined pose, and the paper's Monte Carlo over minimal samples.
#pragma once

#include <optional>
#include <vector>

#include "robust_search.h"

namespace streetview_localizer::detail {

struct PoseCovariance {
  Matrix6d image = Matrix6d::Zero();  ///< of image noise alone
  Matrix6d total = Matrix6d::Zero();  ///< with the errors that the points share
  double noise = 0;                   ///< of a match, one axis [px]
};

/// Empty when the inliers do not fix the pose.
std::optional<PoseCovariance> poseCovariance(const Matches& matches, const std::vector<int>& inliers,
                                             const Pose& T_world_camera, const PointSource& source,
                                             const PosePrior& prior, const PoseSettings& settings);

/// Sample covariance about the samples' mean (paper B, III.C); `plausible` counts them. Empty with fewer than 10.
std::optional<Matrix6d> monteCarloCovariance(const Matches& matches, const std::vector<int>& inliers,
                                             const Pose& T_world_camera, const PointSource& source,
                                             const PoseSettings& settings, int* plausible);

}  // namespace streetview_localizer::detail
