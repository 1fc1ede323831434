#include "air_ground_common/covariance.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace air_ground_common {

Matrix6d covarianceAt(const Matrix6d& covariance, const Eigen::Vector3d& lever) {
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() = -skew(lever);
  return J * covariance * J.transpose();
}

Matrix6d transformed(const Matrix6d& covariance, const Similarity& S) {
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = S.scale * S.R;
  J.bottomRightCorner<3, 3>() = S.R;
  return J * covariance * J.transpose();
}

Matrix6d aboutAxes(const Eigen::Matrix3d& R_new_old, const Matrix6d& covariance) {
  Similarity S;
  S.R = R_new_old;
  return transformed(covariance, S);
}

Matrix6d tiltCovariance(double sigma, const Eigen::Vector3d& position) {
  Matrix6d tilt = Matrix6d::Zero();
  tilt(3, 3) = tilt(4, 4) = sigma * sigma;
  return covarianceAt(tilt, position);
}

double largestStddev(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, eigen.eigenvalues()[2]));
}

}  // namespace air_ground_common
