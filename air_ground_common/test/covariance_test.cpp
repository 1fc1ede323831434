#include "air_ground_common/covariance.h"

#include <gtest/gtest.h>

#include <random>

namespace air_ground_common {
namespace {

/// A square root of a covariance of any kind.
Matrix6d anyRoot() {
  std::mt19937 random(14);
  std::normal_distribution<double> gauss(0, 0.1);
  Matrix6d L = Matrix6d::Zero();
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j <= i; ++j) L(i, j) = gauss(random);
  return L;
}

/// Errors of a pose of another point of the body, or in other axes, one for each column of the root.
template <typename Move>
Matrix6d moved(const Matrix6d& root, const Move& move) {
  Matrix6d out = Matrix6d::Zero();
  for (int k = 0; k < 6; ++k) {
    const Vector6d e = move(root.col(k));
    out += e * e.transpose();
  }
  return out;
}

TEST(CovarianceAt, FollowsTheLever) {
  // Turning about z swings a point 2 m along x towards +y.
  Matrix6d yaw = Matrix6d::Zero();
  yaw(5, 5) = 0.01;
  const Matrix6d at = covarianceAt(yaw, {2, 0, 0});
  EXPECT_NEAR(at(1, 1), 0.04, 1e-12);
  EXPECT_NEAR(at(1, 5), 0.02, 1e-12);
  EXPECT_NEAR(at(5, 5), 0.01, 1e-12);
  EXPECT_NEAR(at(0, 0), 0, 1e-12);
  const Eigen::Vector3d lever(0.7, -1.5, 2);
  const Matrix6d L = anyRoot(), expected = moved(L, [&](Vector6d e) {
                                  e.head<3>() += Eigen::Vector3d(e.tail<3>()).cross(lever);
                                  return e;
                                });
  EXPECT_LT((covarianceAt(L * L.transpose(), lever) - expected).norm(), 1e-12);
  EXPECT_LT((covarianceAt(covarianceAt(yaw, lever), -lever) - yaw).norm(), 1e-12);
}

TEST(Transformed, TurnsBothPartsAndScalesTheTranslation) {
  const Similarity S{2, expSO3({0.3, -0.2, 1.1}), Eigen::Vector3d(1, 2, 3)};
  const Matrix6d L = anyRoot(), expected = moved(L, [&](const Vector6d&e) {
                                  Vector6d out;
                                  out << S.scale * (S.R * e.head<3>()), S.R * e.tail<3>();
                                  return out;
                                });
  EXPECT_LT((transformed(L * L.transpose(), S) - expected).norm(), 1e-12);
  // A quarter turn about z: what was along x is along y.
  const Vector6d d = (Vector6d() << 1, 2, 3, 4, 5, 6).finished(), turned = (Vector6d() << 2, 1, 3, 5, 4, 6).finished();
  const Matrix6d about = aboutAxes(expSO3({0, 0, M_PI / 2}), d.asDiagonal());
  EXPECT_LT((about - Matrix6d(turned.asDiagonal())).norm(), 1e-12);
}

TEST(TiltCovariance, GrowsWithTheDistanceFromTheOrigin) {
  const Matrix6d C = tiltCovariance(0.01, {3, 0, 2});
  EXPECT_NEAR(C(0, 0), 4e-4, 1e-15);  // pitch, 2 m up
  EXPECT_NEAR(C(1, 1), 4e-4, 1e-15);  // roll, 2 m up
  EXPECT_NEAR(C(2, 2), 9e-4, 1e-15);  // pitch, 3 m along x
  EXPECT_EQ(C(5, 5), 0);
}

TEST(LargestStddev, IsThatOfTheWorstDirection) {
  const Eigen::Matrix3d R = expSO3({0.4, 1, -0.7});
  const Eigen::Matrix3d C = R * Eigen::Vector3d(1, 9, 4).asDiagonal() * R.transpose();
  EXPECT_NEAR(largestStddev(C), 3, 1e-12);
  EXPECT_EQ(largestStddev(-1e-18 * Eigen::Matrix3d::Identity()), 0);
}

}  // namespace
}  // namespace air_ground_common
