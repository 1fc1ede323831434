// Cost functions shared by bundle adjustment and the pose graph. A camera's parameters are (c, theta): its centre in
// the map, and R_map_camera = exp(theta) * R_0 with the start R_0 kept beside. No manifold needed, and exact Jacobians.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/sized_cost_function.h>

#include "visual_frontend/self_calibration.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

using air_ground_common::expSO3;
using air_ground_common::logSO3;
using air_ground_common::skew;

template <int Rows, int Cols>
using RowMajor =
    Eigen::Matrix<double, Rows, Cols, Rows == 1 ? Eigen::RowMajor : (Cols == 1 ? Eigen::ColMajor : Eigen::RowMajor)>;

/// exp(theta + d) = exp(J d) exp(theta) to first order.
inline Eigen::Matrix3d leftJacobianSO3(const Eigen::Vector3d& theta) {
  return air_ground_common::rightJacobianSO3(-theta);
}

/// log(exp(r) exp(d)) = r + J d to first order.
inline Eigen::Matrix3d inverseRightJacobianSO3(const Eigen::Vector3d& r) {
  const double angle2 = r.squaredNorm();
  const Eigen::Matrix3d S = skew(r);
  if (angle2 < 1e-8) return Eigen::Matrix3d::Identity() + 0.5 * S + S * S / 12.0;
  const double angle = std::sqrt(angle2);
  return Eigen::Matrix3d::Identity() + 0.5 * S +
         (1 / angle2 - (1 + std::cos(angle)) / (2 * angle * std::sin(angle))) * S * S;
}

/// Camera state from its parameters: 6 (c, theta) or 4 (c, yaw about the map's z).
template <int N>
struct CameraState {
  static_assert(N == 6 || N == 4, "6 or 4 degrees of freedom");
  CameraState(const double* x, const Eigen::Matrix3d& R_0) : c(x) {
    theta.setZero();
    if (N == 6)
      theta = Eigen::Map<const Eigen::Vector3d>(x + 3);
    else
      theta.z() = x[3];
    R = expSO3(theta) * R_0;
  }
  /// d epsilon / d rotation parameters, for the perturbation exp(epsilon) R.
  Eigen::Matrix<double, 3, N - 3> rotationJacobian() const {
    if constexpr (N == 6)
      return leftJacobianSO3(theta);
    else
      return Eigen::Vector3d::UnitZ();
  }
  Eigen::Map<const Eigen::Vector3d> c;
  Eigen::Vector3d theta;
  Eigen::Matrix3d R;
};

/// (x/z, y/z) against a measurement, in sigmas; camera and point.
class ReprojectionCost final : public ceres::SizedCostFunction<2, 6, 3> {
 public:
  ReprojectionCost(const Eigen::Matrix3d& R_0, const Eigen::Vector2d& normalized, const NormalizedNoise& noise)
      : R_0_(R_0), normalized_(normalized), W_(whitening(normalized, noise)) {}

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    const CameraState<6> camera(x[0], R_0_);
    const Eigen::Vector3d q = Eigen::Map<const Eigen::Vector3d>(x[1]) - camera.c;
    const Eigen::Matrix3d Rt = camera.R.transpose();
    const Eigen::Vector3d p = Rt * q;
    if (!(p.z() > 1e-4)) return false;  // Ceres then shortens the step
    const double iz = 1 / p.z();
    Eigen::Map<Eigen::Vector2d> r(residuals);
    r = W_ * (p.head<2>() * iz - normalized_);
    if (!jacobians) return true;
    Eigen::Matrix<double, 2, 3> P;
    P << iz, 0, -p.x() * iz * iz, 0, iz, -p.y() * iz * iz;
    const Eigen::Matrix<double, 2, 3> J = W_ * P * Rt;  // d r / d p_map
    if (jacobians[0]) {
      Eigen::Map<RowMajor<2, 6>> Jc(jacobians[0]);
      Jc.leftCols<3>() = -J;
      Jc.rightCols<3>() = J * skew(q) * camera.rotationJacobian();
    }
    if (jacobians[1]) Eigen::Map<RowMajor<2, 3>>{jacobians[1]} = J;
    return true;
  }

 private:
  Eigen::Matrix3d R_0_;
  Eigen::Vector2d normalized_;
  Eigen::Matrix2d W_;
};

/// The same of a camera whose calibration is off, to the first order; camera, point and calibration's error.
class CalibratedReprojectionCost final : public ceres::SizedCostFunction<2, 6, 3, kCalibrationStates> {
 public:
  CalibratedReprojectionCost(const Eigen::Matrix3d& R_0, const Eigen::Vector2d& normalized,
                             const NormalizedNoise& noise, const RayByCalibration& by_calibration)
      : calibrated_(R_0, normalized, noise), by_error_(-whitening(normalized, noise) * by_calibration) {}

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    if (!calibrated_.Evaluate(x, residuals, jacobians)) return false;
    Eigen::Map<Eigen::Vector2d>{residuals} += by_error_ * Eigen::Map<const CalibrationVector>(x[2]);
    if (jacobians && jacobians[2]) Eigen::Map<RowMajor<2, kCalibrationStates>>{jacobians[2]} = by_error_;
    return true;
  }

 private:
  ReprojectionCost calibrated_;
  RayByCalibration by_error_;
};

/// z in the camera against a measurement, over sigma.
class DepthCost final : public ceres::SizedCostFunction<1, 6, 3> {
 public:
  DepthCost(const Eigen::Matrix3d& R_0, double depth, double sigma)
      : R_0_(R_0), depth_(depth), inverse_sigma_(1 / sigma) {}

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    const CameraState<6> camera(x[0], R_0_);
    const Eigen::Vector3d q = Eigen::Map<const Eigen::Vector3d>(x[1]) - camera.c;
    const Eigen::RowVector3d axis = inverse_sigma_ * camera.R.col(2).transpose();
    residuals[0] = axis.dot(q) - inverse_sigma_ * depth_;
    if (!jacobians) return true;
    if (jacobians[0]) {
      Eigen::Map<RowMajor<1, 6>> Jc(jacobians[0]);
      Jc.leftCols<3>() = -axis;
      Jc.rightCols<3>() = axis * skew(q) * camera.rotationJacobian();
    }
    if (jacobians[1]) Eigen::Map<RowMajor<1, 3>>{jacobians[1]} = axis;
    return true;
  }

 private:
  Eigen::Matrix3d R_0_;
  double depth_, inverse_sigma_;
};

/// Up direction in the camera frame against a measurement, over sigma: a prior on roll and pitch.
class GravityCost final : public ceres::SizedCostFunction<3, 6> {
 public:
  GravityCost(const Eigen::Matrix3d& R_0, const Eigen::Vector3d& up_camera, double sigma)
      : R_0_(R_0), up_(up_camera.normalized()), inverse_sigma_(1 / sigma) {}

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    const CameraState<6> camera(x[0], R_0_);
    const Eigen::Matrix3d Rt = camera.R.transpose();
    Eigen::Map<Eigen::Vector3d> r(residuals);
    r = inverse_sigma_ * (Rt.col(2) - up_);
    if (jacobians && jacobians[0]) {
      Eigen::Map<RowMajor<3, 6>> J(jacobians[0]);
      J.leftCols<3>().setZero();
      J.rightCols<3>() = inverse_sigma_ * Rt * skew(Eigen::Vector3d::UnitZ()) * camera.rotationJacobian();
    }
    return true;
  }

 private:
  Eigen::Matrix3d R_0_;
  Eigen::Vector3d up_;
  double inverse_sigma_;
};

/// Relative pose of two cameras against a measurement: (translation, rotation vector) times the square root of the
/// information. N = 6, or 4 (centre and yaw).
template <int N>
class RelativePoseCost final : public ceres::SizedCostFunction<6, N, N> {
 public:
  RelativePoseCost(const Eigen::Matrix3d& R_a_0, const Eigen::Matrix3d& R_b_0, const Pose& T_a_b,
                   const Matrix6d& sqrt_information)
      : R_a_0_(R_a_0),
        R_b_0_(R_b_0),
        R_measured_(T_a_b.linear()),
        t_measured_(T_a_b.translation()),
        W_(sqrt_information) {}

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    const CameraState<N> a(x[0], R_a_0_), b(x[1], R_b_0_);
    const Eigen::Vector3d q = b.c - a.c;
    const Eigen::Matrix3d R_at = a.R.transpose();
    Vector6d e;
    // Both in the measured frame of b, so that a covariance of T_a_b * exp(d) applies.
    const Eigen::Matrix3d Rm_t = R_measured_.transpose();
    e.head<3>() = Rm_t * (R_at * q - t_measured_);
    e.tail<3>() = logSO3(Rm_t * R_at * b.R);
    Eigen::Map<Vector6d>(residuals).noalias() = W_ * e;
    if (!jacobians) return true;
    const Eigen::Matrix3d K = inverseRightJacobianSO3(e.tail<3>()) * b.R.transpose();
    const Eigen::Matrix3d M = Rm_t * R_at;
    if (jacobians[0]) {
      Eigen::Matrix<double, 6, N> J;
      J.template topLeftCorner<3, 3>() = -M;
      J.template bottomLeftCorner<3, 3>().setZero();
      J.template topRightCorner<3, N - 3>() = M * skew(q) * a.rotationJacobian();
      J.template bottomRightCorner<3, N - 3>() = -K * a.rotationJacobian();
      Eigen::Map<RowMajor<6, N>>{jacobians[0]} = W_ * J;
    }
    if (jacobians[1]) {
      Eigen::Matrix<double, 6, N> J;
      J.template topLeftCorner<3, 3>() = M;
      J.template bottomLeftCorner<3, 3>().setZero();
      J.template topRightCorner<3, N - 3>().setZero();
      J.template bottomRightCorner<3, N - 3>() = K * b.rotationJacobian();
      Eigen::Map<RowMajor<6, N>>{jacobians[1]} = W_ * J;
    }
    return true;
  }

 private:
  Eigen::Matrix3d R_a_0_, R_b_0_, R_measured_;
  Eigen::Vector3d t_measured_;
  Matrix6d W_;
};

}  // namespace visual_frontend
