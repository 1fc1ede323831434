// Gravity in a map.
#pragma once

#include <Eigen/Core>

namespace air_ground_common {

/// What a robot knows of gravity in its map.
struct Vertical {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  ///< unit
  double stddev = 0;                              ///< about each horizontal axis [rad]; 0: not known
};

}  // namespace air_ground_common
