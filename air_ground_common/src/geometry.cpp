#include "air_ground_common/geometry.h"

#include <cmath>
#include <stdexcept>

namespace air_ground_common {

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d S;
  S << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return S;
}

Eigen::Matrix3d expSO3(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  if (angle < 1e-8)
    return Eigen::Quaterniond(1.0, 0.5 * v.x(), 0.5 * v.y(), 0.5 * v.z()).normalized().toRotationMatrix();
  return Eigen::AngleAxisd(angle, v / angle).toRotationMatrix();
}

Eigen::Vector3d logSO3(const Eigen::Matrix3d& rotation) {
  Eigen::Quaterniond q(rotation);
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  const double sin_half = q.vec().norm();
  if (sin_half < 1e-9) return 2.0 * q.vec();
  return 2.0 * std::atan2(sin_half, q.w()) / sin_half * q.vec();
}

Eigen::Matrix3d rightJacobianSO3(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  const Eigen::Matrix3d S = skew(v);
  if (angle < 1e-6) return Eigen::Matrix3d::Identity() - 0.5 * S + S * S / 6.0;
  const double a2 = angle * angle;
  return Eigen::Matrix3d::Identity() - (1 - std::cos(angle)) / a2 * S +
         (angle - std::sin(angle)) / (a2 * angle) * S * S;
}

double wrapAngle(double angle) {
  const double wrapped = std::remainder(angle, 2.0 * M_PI);
  return wrapped <= -M_PI ? M_PI : wrapped;
}

double rotationAngle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) { return logSO3(a.transpose() * b).norm(); }

double yawOf(const Eigen::Matrix3d& R) { return std::atan2(R(1, 0), R(0, 0)); }

Pose yawPose(double yaw, const Eigen::Vector3d& translation) {
  Pose T = Pose::Identity();
  T.linear() = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = translation;
  return T;
}

Eigen::Matrix3d levelingRotation(const Eigen::Vector3d& up) {
  const double norm = up.norm();
  if (!std::isfinite(norm) || norm < 1e-9)
    throw std::invalid_argument("levelingRotation: the up vector is zero or not finite");
  const Eigen::Vector3d axis(up.y(), -up.x(), 0);  // up x z
  const double horizontal = axis.norm();
  if (horizontal < 1e-12 * norm) return Eigen::Vector3d(1, up.z() > 0 ? 1 : -1, up.z() > 0 ? 1 : -1).asDiagonal();
  return expSO3(std::atan2(horizontal, up.z()) / horizontal * axis);
}

Pose interpolate(const Pose& T_a, const Pose& T_b, double s) {
  const Eigen::Quaterniond qa(T_a.linear()), qb(T_b.linear());
  Pose T = Pose::Identity();
  T.linear() = qa.slerp(s, qb).normalized().toRotationMatrix();
  T.translation() = (1 - s) * T_a.translation() + s * T_b.translation();
  return T;
}

Pose normalized(const Pose& T) {
  Pose result = Pose::Identity();
  result.linear() = Eigen::Quaterniond(T.linear()).normalized().toRotationMatrix();
  result.translation() = T.translation();
  return result;
}

bool isValid(const Pose& T) {
  return T.matrix().allFinite() && (T.linear() * T.linear().transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-6 &&
         T.linear().determinant() > 0;
}

Eigen::Matrix3d opticalFromForwardBody() {
  // Rows are the optical axes in the body frame: right = -y, down = -z, forward = +x.
  Eigen::Matrix3d R_optical_body;
  R_optical_body << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return R_optical_body;
}

}  // namespace air_ground_common
