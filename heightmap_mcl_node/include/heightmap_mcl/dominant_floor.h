// The dominant, about horizontal plane of a map: what is up where a robot has no IMU, and what heights are compared
// above where both maps have one.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

namespace heightmap_mcl {

struct DominantFloor {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  ///< unit normal, on the side of the given one
  double share = 0;                               ///< of the points that lie on the plane
};

/// What counts as a floor.
struct FloorRule {
  double max_tilt = 0.2;    ///< of its normal [rad]
  double min_share = 0.1;   ///< of the points, on the plane
  double tolerance = 0;     ///< from the plane, of a point on it; 0: two spacings of the cloud
  double min_flatness = 0;  ///< of the points within four tolerances: share on the plane. Uneven terrain has a third
};

/// That of floors in metres above which heights are compared.
FloorRule flatFloorRule(double max_slope);

/// The plane that holds most points among those whose normal is within `max_tilt` of `up` (RANSAC, then least squares
/// over its points). With `tolerance` 0 free of units. Empty when no such plane meets the rule. Deterministic.
std::optional<DominantFloor> findDominantFloor(const std::vector<Eigen::Vector3f>& points, const Eigen::Vector3d& up,
                                               const FloorRule& rule);

}  // namespace heightmap_mcl
