// SE(3) and SO(3) helpers. Notation: T_a_b maps coordinates in frame b to frame a; p_a is a point in frame a.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace air_ground_common {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// Rigid transform. Its memory is 16-byte aligned: pass by const reference.
using Pose = Eigen::Isometry3d;

/// Skew-symmetric matrix: skew(v) * w == v x w.
Eigen::Matrix3d skew(const Eigen::Vector3d& v);

/// Exponential map of SO(3): rotation vector [rad] to rotation matrix.
Eigen::Matrix3d expSO3(const Eigen::Vector3d& rotation_vector);

/// Logarithm of SO(3): rotation vector [rad] of norm in [0, pi].
Eigen::Vector3d logSO3(const Eigen::Matrix3d& rotation);

/// Right Jacobian of SO(3): exp(v + dv) ~ exp(v) exp(J_r(v) dv).
Eigen::Matrix3d rightJacobianSO3(const Eigen::Vector3d& rotation_vector);

/// Angle [rad] wrapped to (-pi, pi].
double wrapAngle(double angle);

/// Angle [rad] in [0, pi] of the rotation that takes a to b.
double rotationAngle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b);

/// Yaw [rad] of R_world_body, world z up: heading of the body's x axis in the world's xy plane.
double yawOf(const Eigen::Matrix3d& R_world_body);

/// Pose with rotation about z by yaw [rad] and the given translation [m].
Pose yawPose(double yaw, const Eigen::Vector3d& translation);

/// Smallest rotation R_level_frame after which `up_in_frame` (any length > 0) points along +z.
/// Throws std::invalid_argument for a vector that is zero or not finite.
Eigen::Matrix3d levelingRotation(const Eigen::Vector3d& up_in_frame);

/// Interpolates between two poses: linear translation, spherical rotation; s in [0, 1].
Pose interpolate(const Pose& T_a, const Pose& T_b, double s);

/// Re-orthonormalises the rotation; call after long products.
Pose normalized(const Pose& T);

/// True when every entry is finite and the rotation is orthonormal to 1e-6.
bool isValid(const Pose& T);

/// R_optical_body of a camera (x right, y down, z forward) whose optical axis is the body's +x (REP-103).
Eigen::Matrix3d opticalFromForwardBody();

/// Similarity transform: p_a = scale * R * p_b + t.
struct Similarity {
  double scale = 1.0;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  Eigen::Vector3d operator*(const Eigen::Vector3d& p) const { return scale * (R * p) + t; }
};

}  // namespace air_ground_common
