#include "visual_frontend/inertial_costs.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace visual_frontend {

InertialCost::InertialCost(const Eigen::Matrix3d& R_i_0, const Eigen::Matrix3d& R_j_0,
                           const air_ground_common::Pose& T_camera_imu, const Preintegration& motion)
    : R_i_0_(R_i_0),
      R_j_0_(R_j_0),
      R_camera_imu_(T_camera_imu.linear()),
      lever_(T_camera_imu.translation()),
      motion_(motion) {
  // Rounding and effects the noise model leaves out (sampling, timing) keep the information finite.
  Eigen::Matrix<double, 9, 9> covariance = motion.covariance();
  covariance.diagonal().array() += 1e-12;
  const Eigen::Matrix<double, 9, 9> information = covariance.inverse();
  W_ = information.llt().matrixU();
}

bool InertialCost::Evaluate(double const* const* x, double* residuals, double** jacobians) const {
  const CameraState<6> camera_i(x[0], R_i_0_), camera_j(x[3], R_j_0_);
  const Eigen::Map<const Eigen::Vector3d> v_i(x[1]), v_j(x[4]);
  const ImuBias bias{Eigen::Map<const Eigen::Vector3d>(x[2]), Eigen::Map<const Eigen::Vector3d>(x[2] + 3)};
  const Eigen::Vector3d lever_i = camera_i.R * lever_, lever_j = camera_j.R * lever_, turn(x[5][0], x[5][1], x[5][2]);
  const Eigen::Matrix3d R_camera_imu = R_camera_imu_ * air_ground_common::expSO3(turn);
  const Eigen::Matrix3d Rt_i = (camera_i.R * R_camera_imu).transpose(), R_j = camera_j.R * R_camera_imu;
  const double dt = motion_.duration();
  const Eigen::Vector3d g(0, 0, -kGravity);
  const Eigen::Vector3d dv = v_j - v_i - g * dt;
  const Eigen::Vector3d dp = camera_j.c + lever_j - camera_i.c - lever_i - v_i * dt - 0.5 * dt * dt * g;
  const Eigen::Matrix3d E = motion_.rotation(bias).transpose() * Rt_i * R_j;
  const Eigen::Vector3d r_theta = air_ground_common::logSO3(E);
  Eigen::Matrix<double, 9, 1> r;
  r << r_theta, Rt_i * dv - motion_.velocity(bias), Rt_i * dp - motion_.position(bias);
  Eigen::Map<Eigen::Matrix<double, 9, 1>>(residuals).noalias() = W_ * r;
  if (!jacobians) return true;

  const Eigen::Matrix3d J_r = inverseRightJacobianSO3(r_theta);
  if (jacobians[0]) {
    Eigen::Matrix<double, 9, 6> J = Eigen::Matrix<double, 9, 6>::Zero();
    J.block<3, 3>(6, 0) = -Rt_i;
    J.block<3, 3>(0, 3) = -J_r * R_j.transpose();
    J.block<3, 3>(3, 3) = Rt_i * skew(dv);
    J.block<3, 3>(6, 3) = Rt_i * (skew(dp) + skew(lever_i));
    J.rightCols<3>() = (J.rightCols<3>() * camera_i.rotationJacobian()).eval();
    rowMajor<9, 6>(jacobians[0]) = W_ * J;
  }
  if (jacobians[1]) {
    Eigen::Matrix<double, 9, 3> J;
    J << Eigen::Matrix3d::Zero(), -Rt_i, -Rt_i * dt;
    rowMajor<9, 3>(jacobians[1]) = W_ * J;
  }
  if (jacobians[2]) {
    Eigen::Matrix<double, 9, 6> J = -motion_.biasJacobian();
    J.block<3, 3>(0, 0) = (J_r * E.transpose() * J.block<3, 3>(0, 0)).eval();
    rowMajor<9, 6>(jacobians[2]) = W_ * J;
  }
  if (jacobians[3]) {
    Eigen::Matrix<double, 9, 6> J = Eigen::Matrix<double, 9, 6>::Zero();
    J.block<3, 3>(6, 0) = Rt_i;
    J.block<3, 3>(0, 3) = J_r * R_j.transpose();
    J.block<3, 3>(6, 3) = -Rt_i * skew(lever_j);
    J.rightCols<3>() = (J.rightCols<3>() * camera_j.rotationJacobian()).eval();
    rowMajor<9, 6>(jacobians[3]) = W_ * J;
  }
  if (jacobians[4]) {
    Eigen::Matrix<double, 9, 3> J;
    J << Eigen::Matrix3d::Zero(), Rt_i, Eigen::Matrix3d::Zero();
    rowMajor<9, 3>(jacobians[4]) = W_ * J;
  }
  if (jacobians[5]) {
    Eigen::Matrix<double, 9, 3> J;
    J << J_r * (Eigen::Matrix3d::Identity() - (Rt_i * R_j).transpose()), skew(Rt_i * dv), skew(Rt_i * dp);
    rowMajor<9, 3>(jacobians[5]) = W_ * J * air_ground_common::rightJacobianSO3(turn);
  }
  return true;
}

GyroCost::GyroCost(const Eigen::Matrix3d& R_i_0, const Eigen::Matrix3d& R_j_0, const Eigen::Matrix3d& R_camera_imu,
                   const Preintegration& motion)
    : R_i_0_(R_i_0), R_j_0_(R_j_0), R_camera_imu_(R_camera_imu), motion_(motion) {
  const Eigen::Matrix3d covariance = motion.covariance().topLeftCorner<3, 3>() + 1e-12 * Eigen::Matrix3d::Identity();
  W_ = Eigen::Matrix3d(covariance.inverse()).llt().matrixU();
}

bool GyroCost::Evaluate(double const* const* x, double* residuals, double** jacobians) const {
  const CameraState<6> camera_i(x[0], R_i_0_), camera_j(x[2], R_j_0_);
  const ImuBias bias{Eigen::Map<const Eigen::Vector3d>(x[1]), Eigen::Map<const Eigen::Vector3d>(x[1] + 3)};
  const Eigen::Matrix3d R_j = camera_j.R * R_camera_imu_;
  const Eigen::Matrix3d E = motion_.rotation(bias).transpose() * (camera_i.R * R_camera_imu_).transpose() * R_j;
  const Eigen::Vector3d r = air_ground_common::logSO3(E);
  Eigen::Map<Eigen::Vector3d> out(residuals);
  out.noalias() = W_ * r;
  if (!jacobians) return true;
  const Eigen::Matrix3d J_r = W_ * inverseRightJacobianSO3(r);
  Eigen::Matrix<double, 3, 6> J = Eigen::Matrix<double, 3, 6>::Zero();
  if (jacobians[0]) {
    J.rightCols<3>() = -J_r * R_j.transpose() * camera_i.rotationJacobian();
    rowMajor<3, 6>(jacobians[0]) = J;
  }
  if (jacobians[1]) {
    J.setZero();
    J.leftCols<3>() = -J_r * E.transpose() * motion_.biasJacobian().topLeftCorner<3, 3>();
    rowMajor<3, 6>(jacobians[1]) = J;
  }
  if (jacobians[2]) {
    J.setZero();
    J.rightCols<3>() = J_r * R_j.transpose() * camera_j.rotationJacobian();
    rowMajor<3, 6>(jacobians[2]) = J;
  }
  return true;
}

}  // namespace visual_frontend
