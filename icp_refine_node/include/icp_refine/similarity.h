// Similarities T_a_b: p_a = scale R p_b + t. The alignment of a map whose scale is known only so well.
#pragma once

#include <Eigen/Geometry>
#include <cmath>

#include "air_ground_common/similarity.h"

namespace icp_refine {

using air_ground_common::compose;
using air_ground_common::inverse;
using air_ground_common::Matrix6d;
using air_ground_common::Matrix7d;
using air_ground_common::motion;
using air_ground_common::Pose;
using air_ground_common::Similarity;
using air_ground_common::Vector6d;
using air_ground_common::Vector7d;

/// The rigid transform, followed or not by a change of scale about the origin of frame b.
inline Similarity similarity(const Pose& T_a_b, double scale = 1) {
  return {scale, T_a_b.linear(), T_a_b.translation()};
}

/// Rotation and translation alone: what the message's pose holds.
inline Pose poseOf(const Similarity& T) {
  Pose out = Pose::Identity();
  out.linear() = T.R;
  out.translation() = T.t;
  return out;
}

/// The rigid transform of T's rotation that maps the point p_b to the same place as T does: what tf, which knows no
/// scale, says about the neighbourhood of that point.
inline Pose rigidAt(const Similarity& T_a_b, const Eigen::Vector3d& p_b) {
  Pose out = Pose::Identity();
  out.linear() = T_a_b.R;
  out.translation() = T_a_b * p_b - T_a_b.R * p_b;
  return out;
}

/// Finite, a rotation, and a positive scale.
inline bool isValid(const Similarity& T) {
  return std::isfinite(T.scale) && T.scale > 0 && air_ground_common::isValid(poseOf(T));
}

}  // namespace icp_refine
