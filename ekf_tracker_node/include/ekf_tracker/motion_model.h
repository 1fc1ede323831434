// The motion of (x, y, z, yaw) by visual odometry: equations 1-9 of Majdik et al. 2014 ("paper B").
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace ekf_tracker {

using Vector4d = Eigen::Matrix<double, 4, 1>;
using Matrix4d = Eigen::Matrix<double, 4, 4>;

/// Equation 2: q = (x, y, z, yaw) in `world`, moved by the visual odometry's increment (translation in its own unit, in
/// the levelled body frame of the earlier time; yaw), whose translation the scale turns metric (equation 5). The yaw is
/// not wrapped, so that the function can be differentiated.
template <typename T>
Eigen::Matrix<T, 4, 1> move(const Eigen::Matrix<T, 4, 1>& q, const Eigen::Matrix<T, 4, 1>& increment, const T& scale) {
  using std::cos;
  using std::sin;
  const T c = cos(q[3]), s = sin(q[3]);
  Eigen::Matrix<T, 4, 1> moved;
  moved << q[0] + scale * (c * increment[0] - s * increment[1]), q[1] + scale * (s * increment[0] + c * increment[1]),
      q[2] + scale * increment[2], q[3] + increment[3];
  return moved;
}

/// Partial derivatives of move() by central differences (equation 9; the paper computes them numerically).
struct MotionJacobians {
  Matrix4d by_state;
  Matrix4d by_increment;
  Vector4d by_scale;
};
MotionJacobians motionJacobians(const Vector4d& q, const Vector4d& increment, double scale);

/// A tilt that is off stays so for about this long [s].
constexpr double kTiltStays = 20;

/// One step of visual odometry (equation 4): what happened between two stamps.
struct Increment {
  double previous_stamp = 0;  ///< [s]
  double stamp = 0;           ///< [s]
  Vector4d motion =
      Vector4d::Zero();  ///< dx, dy, dz [m, or the odometry's unit], dyaw [rad]; levelled earlier body frame
  Matrix4d covariance = Matrix4d::Zero();  ///< of `motion`, in the same units
  bool metric = true;                      ///< false: the translation is known up to a constant factor only
  double scale_stddev = 0;                 ///< metric: standard deviation of the factor left to apply; 0 = not known
  double tilt_stddev = 0;                  ///< of the levelling, about each horizontal axis [rad]
  unsigned map_id = 0;                     ///< changes when the odometry started afresh
  bool new_unit = false;  ///< set by the tracker: the factor has nothing to do with that of earlier increments
  bool gap = false;       ///< made by the tracker where the odometry said nothing: scale does not apply
  bool assumed_covariance = false;  ///< set by the tracker: its default stands in, which no factor corrects
};

/// From a relative pose of the tilted body, T_previous_current, to the levelled increment: `R_level_previous` is the
/// roll and pitch of the earlier body (yaw 0; identity neglects them, as the paper does). The covariance is of (x, y,
/// z, yaw). Throws std::invalid_argument when the pose is not finite.
Increment levelIncrement(const Eigen::Isometry3d& T_previous_current, const Matrix4d& covariance,
                         const Eigen::Matrix3d& R_level_previous);

/// The part of the increment up to `stamp` and the rest, along the arc of constant velocity and turn rate; the
/// covariance is shared in proportion to time. `stamp` must lie strictly inside.
void split(const Increment& whole, double stamp, Increment* first, Increment* second);

/// True when the leading n x n block is finite, symmetric to 1e-6 of its size, and positive definite.
bool isCovariance(const Eigen::Ref<const Eigen::MatrixXd>& m);

}  // namespace ekf_tracker
