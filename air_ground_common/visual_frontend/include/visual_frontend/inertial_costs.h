// Ceres cost functions of the inertial bundle adjustment. Cameras are (c, theta) as in visual_frontend's ceres_costs.h:
// R_map_camera = exp(theta) R_0; biases are (gyro, accelerometer).
#pragma once

#include <ceres/sized_cost_function.h>

#include "visual_frontend/ceres_costs.h"
#include "visual_frontend/imu_preintegration.h"

namespace visual_frontend {

template <int Rows, int Cols>
Eigen::Map<RowMajor<Rows, Cols>> rowMajor(double* data) {
  return Eigen::Map<RowMajor<Rows, Cols>>(data);
}

/// Parameters: camera i, velocity i, bias i, camera j, velocity j, mounting (rotation vector t: the IMU's axes in the
/// camera's are R_camera_imu exp(t)). Residual: (rotation, velocity, position) of the preintegration in the first IMU
/// frame, whitened.
class InertialCost final : public ceres::SizedCostFunction<9, 6, 3, 6, 6, 3, 3> {
 public:
  InertialCost(const Eigen::Matrix3d& R_i_0, const Eigen::Matrix3d& R_j_0, const air_ground_common::Pose& T_camera_imu,
               const Preintegration& motion);

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override;

 private:
  Eigen::Matrix3d R_i_0_, R_j_0_, R_camera_imu_;
  Eigen::Vector3d lever_;
  Preintegration motion_;
  Eigen::Matrix<double, 9, 9> W_;
};

/// Parameters: camera i, bias i, camera j. Residual: the rotation of the preintegration alone, whitened; for maps whose
/// unit is not known yet.
class GyroCost final : public ceres::SizedCostFunction<3, 6, 6, 6> {
 public:
  GyroCost(const Eigen::Matrix3d& R_i_0, const Eigen::Matrix3d& R_j_0, const Eigen::Matrix3d& R_camera_imu,
           const Preintegration& motion);

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override;

 private:
  Eigen::Matrix3d R_i_0_, R_j_0_, R_camera_imu_;
  Preintegration motion_;
  Eigen::Matrix3d W_;
};

/// Random walk of the biases between two keyframes.
class BiasWalkCost final : public ceres::SizedCostFunction<6, 6, 6> {
 public:
  BiasWalkCost(double gyro_sigma, double accel_sigma) {
    weight_ << Eigen::Vector3d::Constant(1 / gyro_sigma), Eigen::Vector3d::Constant(1 / accel_sigma);
  }
  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    using Vector = Eigen::Matrix<double, 6, 1>;
    Eigen::Map<Vector> r(residuals);
    r = weight_.cwiseProduct(Eigen::Map<const Vector>(x[1]) - Eigen::Map<const Vector>(x[0]));
    if (!jacobians) return true;
    if (jacobians[0]) rowMajor<6, 6>(jacobians[0]) = Eigen::Matrix<double, 6, 6>((-weight_).asDiagonal());
    if (jacobians[1]) rowMajor<6, 6>(jacobians[1]) = Eigen::Matrix<double, 6, 6>(weight_.asDiagonal());
    return true;
  }

 private:
  Eigen::Matrix<double, 6, 1> weight_;
};

/// A parameter block of six against its mean, each entry with its own standard deviation; 0 leaves an entry free.
class PriorCost final : public ceres::SizedCostFunction<6, 6> {
 public:
  using Vector = Eigen::Matrix<double, 6, 1>;
  PriorCost(const Vector& mean, const Vector& sigma)
      : mean_(mean), weight_((sigma.array() > 0).select(sigma.cwiseInverse(), 0.0)) {}
  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    Eigen::Map<Vector> r(residuals);
    r = weight_.cwiseProduct(Eigen::Map<const Vector>(x[0]) - mean_);
    if (jacobians && jacobians[0]) rowMajor<6, 6>(jacobians[0]) = Eigen::Matrix<double, 6, 6>(weight_.asDiagonal());
    return true;
  }

 private:
  Vector mean_, weight_;
};

}  // namespace visual_frontend
