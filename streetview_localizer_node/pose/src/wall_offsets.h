// Walls of a cadastral model stand decimetres off, each on its own, and are flat where facades are not: their offsets
// and their relief, estimated together with the pose.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "robust_search.h"

namespace streetview_localizer::detail {

/// Of the wall that `ray` meets; without a normal the wall faces the ray.
Eigen::Vector3d unitNormal(const Eigen::Vector3d& normal, const Eigen::Vector3d& ray);

/// How a point cast from `centre` onto a wall moves for each metre that the wall stands farther out along its normal:
/// along its ray. Grazing rays move by at most ten times the offset.
Eigen::Vector3d castDirection(const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                              const Eigen::Vector3d& centre);

/// The wall of a match and the 2 m of it, along and up, that it lies on: relief that the model lacks (a balcony, a row
/// of reveals, a recessed ground floor) is alike there. Of a match with a wall.
using Patch = std::array<int, 3>;
Patch patchOf(const Matches& m, std::size_t i);

struct WallAdjustment {
  Pose T_world_camera = Pose::Identity();
  Matches matches;  ///< all of them, their points moved with their walls
};

/// Minimises, over the pose, an offset o_w of each wall with matches and one more, o_q, of each of its patches,
///   sum_i rho(|e_i|^2 / s^2) / k  +  sum_w o_w^2 / source.model_lateral_stddev^2
///                                 +  sum_q o_q^2 / source.model_relief_stddev^2  (+ gravity),
/// with rho: Cauchy, over the first `usable` matches within three times the inlier threshold of `start`. e:
/// reprojection error [px], s: `noise` [px], k: matches of one wall err alike, and count as no more than
/// kEffectiveMeasurements. Empty with fewer than two walls or patches, which alone tell an offset, or when the result
/// explains the matches no better.
std::optional<WallAdjustment> adjustWalls(const Matches& matches, std::size_t usable, const Pose& start, double noise,
                                          const PointSource& source, const PosePrior& prior,
                                          const PoseSettings& settings);

}  // namespace streetview_localizer::detail
