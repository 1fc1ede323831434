// The vertical of a map whose robot has no IMU: the normal of its dominant, about horizontal plane.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

namespace heightmap_mcl {

struct DominantFloor {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  ///< unit normal, on the side of the given one
  double share = 0;                               ///< of the points that lie on the plane
};

/// The plane that holds most of the points among those whose normal is within `max_tilt` [rad] of `up` (RANSAC, then
/// least squares over its points). Free of units: a point lies on it within two spacings of the cloud. Empty when no
/// such plane holds `min_share` of the points. Deterministic.
std::optional<DominantFloor> findDominantFloor(const std::vector<Eigen::Vector3f>& points, const Eigen::Vector3d& up,
                                               double max_tilt, double min_share);

}  // namespace heightmap_mcl
