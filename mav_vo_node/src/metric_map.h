// The frame of a map that has become metric: level, its origin and heading 0 at base_link of the first keyframe.
#pragma once

#include "air_ground_common/geometry.h"

namespace mav_vo {

/// Rotation about the vertical that gives base_link heading 0.
Eigen::Matrix3d headingZero(const Eigen::Matrix3d& R_map_base);

/// p_metric [m] = scale R p_visual + t. `up`: the vertical in the visual map, of any length.
/// Throws std::invalid_argument where that is zero or not finite.
air_ground_common::Similarity metricMap(double scale, const Eigen::Vector3d& up,
                                        const air_ground_common::Pose& T_visual_camera_first,
                                        const air_ground_common::Pose& T_base_camera);

}  // namespace mav_vo
