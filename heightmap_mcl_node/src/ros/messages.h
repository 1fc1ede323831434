// The library's results as messages.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <air_ground/HeightMap.h>
#include <geometry_msgs/PoseArray.h>
#include <nav_msgs/OccupancyGrid.h>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

air_ground::HeightMap toMsg(const HeightMap& map, const std_msgs::Header& header, std::uint32_t map_id);

/// A cost as occupancy: 0 best, 100 worst, -1 too little overlap. The square root spreads the low end.
nav_msgs::OccupancyGrid toMsg(const CostMap& map, const Eigen::Vector2d& shift, const std_msgs::Header& header);

air_ground::AlignmentEstimate toMsg(const CoarseEstimate& estimate, const std_msgs::Header& header,
                                    const std::string& mav_frame, std::uint32_t map_id);

/// The particles as poses of the MAV at height `z`; `heading`: of the MAV in its own map [rad].
geometry_msgs::PoseArray toMsg(const std::vector<Particle>& particles, double z, double heading,
                               const std_msgs::Header& header);

}  // namespace heightmap_mcl
