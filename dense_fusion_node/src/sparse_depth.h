// Depth maps take their scale from the landmarks of the odometry.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "dense_fusion/depth_map.h"

namespace dense_fusion {

/// What the depths of `map` are to be multiplied with to agree with the sparse points (map frame [m]) that are seen in
/// it: Tukey's estimate of location of the logarithms of both depths' ratio, of those within 8 %. Points behind a
/// surface drop out. Empty where fewer than 30 are left, or they do not tell it to 0.2 % (standard deviation).
std::optional<double> sparseDepthRatio(const DepthMap& map, const std::vector<Eigen::Vector3f>& points);

}  // namespace dense_fusion
