// What is up in the map of a MAV without IMU: vehicles fly about level, however they turn.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "air_ground_common/vertical.h"

namespace mav_vo {

/// Where the vehicle looked to and what was beside it, in the map.
struct FlownAttitude {
  double stamp = 0;         ///< [s]
  Eigen::Vector3d lateral;  ///< unit: level but for the vehicle's roll (of a camera on a gimbal: hardly any)
  Eigen::Vector3d below;    ///< about down, or ahead and down: tells up from down
};

/// The direction that the lateral axes are across, in the least-squares sense. Attitudes that are a second apart count
/// as independent. stddev 0, not known, where the vehicle has not turned enough to tell, or does not fly level.
air_ground_common::Vertical verticalOfFlight(const std::vector<FlownAttitude>& attitudes);

}  // namespace mav_vo
