// The frame of a map: level, heading 0 at base_link of the first keyframe, and its origin, too, once it is metric.
#pragma once

#include "air_ground_common/geometry.h"

namespace mav_vo {

/// R_map_visual that makes `up` upright and gives base_link of the first camera heading 0. `up`: the vertical in the
/// visual map, of any length. Throws std::invalid_argument where that is zero or not finite.
Eigen::Matrix3d levelRotation(const Eigen::Vector3d& up, const Eigen::Matrix3d& R_visual_camera_first,
                              const air_ground_common::Pose& T_base_camera);

/// p_metric [m] = scale R p_visual + t. `up`: the vertical in the visual map, of any length.
/// Throws std::invalid_argument where that is zero or not finite.
air_ground_common::Similarity metricMap(double scale, const Eigen::Vector3d& up,
                                        const air_ground_common::Pose& T_visual_camera_first,
                                        const air_ground_common::Pose& T_base_camera);

}  // namespace mav_vo
