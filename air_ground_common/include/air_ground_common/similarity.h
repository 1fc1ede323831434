// Products of similarities T_a_b: p_a = scale R p_b + t.
#pragma once

#include "air_ground_common/geometry.h"

namespace air_ground_common {

/// T_a_b T_b_c.
inline Similarity compose(const Similarity& T_a_b, const Similarity& T_b_c) {
  return {T_a_b.scale * T_b_c.scale, T_a_b.R * T_b_c.R, T_a_b * T_b_c.t};
}

inline Similarity inverse(const Similarity& T) {
  const Eigen::Matrix3d R = T.R.transpose();
  return {1 / T.scale, R, -(R * T.t) / T.scale};
}

}  // namespace air_ground_common
