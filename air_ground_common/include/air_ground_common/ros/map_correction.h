// Corrections of a map as messages.
#pragma once

#include <air_ground/CloudCorrections.h>
#include <nav_msgs/Path.h>

#include "air_ground_common/map_correction.h"
#include "air_ground_common/trajectory.h"

namespace air_ground_common::ros_utils {

nav_msgs::Path toMsg(const Trajectory& trajectory, const std_msgs::Header& header);
/// Throws std::invalid_argument for a pose that is none, or lies beyond 1000 km.
PosesByStamp fromMsg(const nav_msgs::Path& msg);

air_ground::CloudCorrections toMsg(const CloudCorrections& corrections, const std_msgs::Header& header,
                                   std::uint32_t map_id);
/// Throws std::invalid_argument for lists of different lengths, a pose that is none or lies beyond 1000 km, and scales
/// that are neither 0 nor between 0.1 and 10.
CloudCorrections fromMsg(const air_ground::CloudCorrections& msg);

}  // namespace air_ground_common::ros_utils
