// Decompositions of small matrices, compiled once: each takes a compiler 5 to 15 s wherever it is instantiated from
// Eigen's headers.
#pragma once

#include "air_ground_common/geometry.h"

namespace air_ground_common {

/// Eigenvalues in ascending order; the eigenvector of value k is column k.
template <int N>
struct SymmetricEigen {
  Eigen::Matrix<double, N, 1> values;
  Eigen::Matrix<double, N, N> vectors;
};

/// Of a symmetric matrix, of which the lower triangle is read.
SymmetricEigen<4> symmetricEigen(const Eigen::Matrix4d& m);
SymmetricEigen<6> symmetricEigen(const Matrix6d& m);

/// Inverse of a regular matrix; the entries of a singular one's are not finite.
Matrix6d inverse(const Matrix6d& m);

/// x with A x = b for a symmetric positive semidefinite A.
Vector6d solveSymmetric(const Matrix6d& A, const Vector6d& b);

/// True when a Cholesky factor of the symmetric matrix exists.
bool isPositiveDefinite(const Eigen::Ref<const Eigen::MatrixXd>& m);

/// e^T C^-1 e of an error e and its positive definite covariance C: squared Mahalanobis distance, without unit.
double squaredMahalanobis(const Eigen::Ref<const Eigen::VectorXd>& e, const Eigen::Ref<const Eigen::MatrixXd>& C);

}  // namespace air_ground_common
