// How far a keyframe that has moved takes what it saw with it.
#pragma once

#include "air_ground_common/geometry.h"

namespace rgbd_slam {

/// Largest distance that a point within `range` of the camera moves.
inline double displacement(const air_ground_common::Pose& a, const air_ground_common::Pose& b, double range) {
  return (a.translation() - b.translation()).norm() + range * air_ground_common::rotationAngle(a.linear(), b.linear());
}

}  // namespace rgbd_slam
