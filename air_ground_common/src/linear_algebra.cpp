#include "air_ground_common/linear_algebra.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>

namespace air_ground_common {
namespace {

template <int N>
SymmetricEigen<N> decompose(const Eigen::Matrix<double, N, N>& m) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, N, N>> solver(m);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

}  // namespace

SymmetricEigen<4> symmetricEigen(const Eigen::Matrix4d& m) { return decompose<4>(m); }

SymmetricEigen<6> symmetricEigen(const Matrix6d& m) { return decompose<6>(m); }

Matrix6d inverse(const Matrix6d& m) { return m.inverse(); }

Vector6d solveSymmetric(const Matrix6d& A, const Vector6d& b) { return A.ldlt().solve(b); }

bool isPositiveDefinite(const Eigen::Ref<const Eigen::MatrixXd>& m) {
  return Eigen::LLT<Eigen::MatrixXd>(m).info() == Eigen::Success;
}

double squaredMahalanobis(const Eigen::Ref<const Eigen::VectorXd>& e, const Eigen::Ref<const Eigen::MatrixXd>& C) {
  return e.dot(C.ldlt().solve(e));
}

}  // namespace air_ground_common
