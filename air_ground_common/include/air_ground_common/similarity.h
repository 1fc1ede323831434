// Products of similarities T_a_b: p_a = scale R p_b + t.
#pragma once

#include <cmath>

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

/// Translation [m], rotation vector [rad], relative scale: p' = c + exp(scale) exp(rotation) (p - c) + translation.
using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix7d = Eigen::Matrix<double, 7, 7>;

/// The motion of such a step about the point c.
inline Similarity motion(const Vector7d& step, const Eigen::Vector3d& centre) {
  Similarity out{std::exp(step[6]), expSO3(step.segment<3>(3)), Eigen::Vector3d::Zero()};
  out.t = centre + step.head<3>() - out * centre;
  return out;
}

}  // namespace air_ground_common
