#include "ekf_tracker/motion_model.h"

#include <Eigen/Cholesky>
#include <stdexcept>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {
namespace {

// V(angle) maps a constant body velocity to the chord of its arc: the xy part of SE(2)'s exponential.
Eigen::Matrix2d chord(double angle) {
  Eigen::Matrix2d v;
  if (std::abs(angle) < 1e-6) {
    v << 1, -angle / 2, angle / 2, 1;
  } else {
    const double s = std::sin(angle) / angle, c = (1 - std::cos(angle)) / angle;
    v << s, -c, c, s;
  }
  return v;
}

}  // namespace

MotionJacobians motionJacobians(const Vector4d& q, const Vector4d& increment, double scale) {
  // Truncation grows with h^2, rounding with 1/h: 1e-5 balances them at coordinates of some hundred metres.
  constexpr double h = 1e-5;
  // Differentiated about the origin: move() adds the position, which would only cost digits.
  Vector4d at = q;
  at.head<3>().setZero();
  MotionJacobians j;
  for (int i = 0; i < 4; ++i) {
    Vector4d step = Vector4d::Zero();
    step[i] = h;
    j.by_state.col(i) =
        (move<double>(at + step, increment, scale) - move<double>(at - step, increment, scale)) / (2 * h);
    j.by_increment.col(i) =
        (move<double>(at, increment + step, scale) - move<double>(at, increment - step, scale)) / (2 * h);
  }
  j.by_scale = (move<double>(at, increment, scale + h) - move<double>(at, increment, scale - h)) / (2 * h);
  return j;
}

Increment levelIncrement(const Eigen::Isometry3d& T_previous_current, const Matrix4d& covariance,
                         const Eigen::Matrix3d& R_level_previous) {
  if (!T_previous_current.matrix().allFinite() || !R_level_previous.allFinite())
    throw std::invalid_argument("the relative pose of an increment must be finite");
  Increment out;
  out.motion.head<3>() = R_level_previous * T_previous_current.translation();
  out.motion[3] = air_ground_common::yawOf(R_level_previous * T_previous_current.linear());
  Matrix4d turn = Matrix4d::Identity();
  turn.topLeftCorner<3, 3>() = R_level_previous;
  out.covariance = turn * covariance * turn.transpose();
  return out;
}

void split(const Increment& whole, double stamp, Increment* first, Increment* second) {
  if (!(stamp > whole.previous_stamp && stamp < whole.stamp))
    throw std::invalid_argument("split: the stamp must lie inside the increment");
  const double share = (stamp - whole.previous_stamp) / (whole.stamp - whole.previous_stamp);
  const double angle = whole.motion[3];
  const Eigen::Vector2d velocity = chord(angle).inverse() * whole.motion.head<2>();
  Increment a = whole, b = whole;
  const auto part = [&](double fraction) {
    Vector4d m;
    m << chord(fraction * angle) * (fraction * velocity), fraction * whole.motion[2], fraction * angle;
    return m;
  };
  a.stamp = b.previous_stamp = stamp;
  a.motion = part(share);
  b.motion = part(1 - share);
  a.covariance = share * whole.covariance;
  // The rest is expressed in the body as it stands at the split.
  Matrix4d turn = Matrix4d::Identity();
  turn.topLeftCorner<2, 2>() = Eigen::Rotation2Dd(-share * angle).toRotationMatrix();
  b.new_unit = false;
  b.covariance = (1 - share) * turn * whole.covariance * turn.transpose();
  *first = a;
  *second = b;
}

bool isCovariance(const Eigen::Ref<const Eigen::MatrixXd>& m) {
  if (!m.allFinite()) return false;
  if ((m - m.transpose()).cwiseAbs().maxCoeff() > 1e-6 * m.cwiseAbs().maxCoeff()) return false;
  const Eigen::LLT<Eigen::MatrixXd> llt(m);
  return llt.info() == Eigen::Success && llt.matrixL().toDenseMatrix().diagonal().minCoeff() > 0;
}

}  // namespace ekf_tracker
