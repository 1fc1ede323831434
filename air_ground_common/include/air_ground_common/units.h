// Units other than the radian, metre and second.
#pragma once

#include <cmath>

namespace air_ground_common {

constexpr double kDegree = M_PI / 180;  ///< [rad]

}  // namespace air_ground_common
