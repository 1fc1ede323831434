#include "ekf_tracker/motion_model.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

#include "air_ground_common/geometry.h"

namespace ekf_tracker {
namespace {

TEST(MotionModel, TurnsTheStepByTheYaw) {
  const Vector4d moved = move<double>(Vector4d(1, 2, 3, M_PI / 2), Vector4d(1, 0.5, 0.2, 0.1), 2);
  EXPECT_LT((moved - Vector4d(1 - 1, 2 + 2, 3.4, M_PI / 2 + 0.1)).norm(), 1e-12);
}

TEST(MotionModel, NumericJacobiansEqualAutomaticOnes) {
  using Jet = ceres::Jet<double, 9>;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int n = 0; n < 200; ++n) {
    const Vector4d q(500 * uniform(random), 500 * uniform(random), 50 * uniform(random), M_PI * uniform(random));
    const Vector4d d(2 * uniform(random), 2 * uniform(random), uniform(random), 0.5 * uniform(random));
    const double scale = 2 + 1.9 * uniform(random);
    Eigen::Matrix<Jet, 4, 1> q_jet, d_jet;
    for (int i = 0; i < 4; ++i) q_jet[i] = Jet(q[i], i), d_jet[i] = Jet(d[i], 4 + i);
    const Eigen::Matrix<Jet, 4, 1> moved = move<Jet>(q_jet, d_jet, Jet(scale, 8));
    const MotionJacobians j = motionJacobians(q, d, scale);
    for (int r = 0; r < 4; ++r) {
      for (int c = 0; c < 4; ++c) {
        EXPECT_NEAR(j.by_state(r, c), moved[r].v[c], 1e-8);
        EXPECT_NEAR(j.by_increment(r, c), moved[r].v[4 + c], 1e-8);
      }
      EXPECT_NEAR(j.by_scale[r], moved[r].v[8], 1e-8);
    }
  }
}

TEST(MotionModel, SplittingChangesNothingWhateverTheOrder) {
  Increment whole;
  whole.previous_stamp = 1;
  whole.stamp = 2;
  whole.motion << 1.0, 0.4, -0.2, 0.8;
  whole.covariance = Vector4d(0.1, 0.2, 0.3, 0.05).asDiagonal();
  Increment a, b, c, d, e, f;
  split(whole, 1.3, &a, &b);
  split(b, 1.6, &c, &d);
  split(whole, 1.6, &e, &f);
  Vector4d q = move<double>(Vector4d::Zero(), a.motion, 1);
  q = move<double>(q, c.motion, 1);
  EXPECT_LT((q - e.motion).norm(), 1e-12);
  q = move<double>(q, d.motion, 1);
  EXPECT_LT((q - whole.motion).norm(), 1e-12);
  EXPECT_LT((f.motion - d.motion).norm(), 1e-12);
  EXPECT_LT((f.covariance - d.covariance).norm(), 1e-12);
  EXPECT_NEAR((a.covariance + b.covariance).trace(), whole.covariance.trace(), 1e-12);
  EXPECT_THROW(split(whole, 2.5, &a, &b), std::invalid_argument);
}

TEST(MotionModel, LevellingTakesTheTiltOut) {
  // A body pitched nose-down by 20 degrees flies level and turns: in its own axes it climbs.
  const Eigen::Matrix3d tilt = Eigen::AngleAxisd(20 * M_PI / 180, Eigen::Vector3d::UnitY()).toRotationMatrix();
  Eigen::Isometry3d T_previous_current = Eigen::Isometry3d::Identity();
  T_previous_current.translation() = tilt.transpose() * Eigen::Vector3d(1, 0, 0);
  T_previous_current.linear() =
      tilt.transpose() * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()).toRotationMatrix() * tilt;
  const Matrix4d covariance = Vector4d(1e-4, 4e-4, 9e-4, 1e-5).asDiagonal();
  const Increment levelled = levelIncrement(T_previous_current, covariance, tilt);
  EXPECT_LT((levelled.motion - Vector4d(1, 0, 0, 0.3)).norm(), 1e-12);
  EXPECT_NEAR(levelled.covariance.trace(), covariance.trace(), 1e-12);
  EXPECT_GT(std::abs(levelled.covariance(0, 2)), 1e-5);
  EXPECT_GT(levelIncrement(T_previous_current, covariance, Eigen::Matrix3d::Identity()).motion[2], 0.3);
  T_previous_current.translation().x() = NAN;
  EXPECT_THROW(levelIncrement(T_previous_current, covariance, tilt), std::invalid_argument);
}

TEST(MotionModel, CovariancesAreChecked) {
  EXPECT_TRUE(isCovariance(Matrix4d::Identity()));
  Matrix4d bad = Matrix4d::Identity();
  bad(0, 0) = NAN;
  EXPECT_FALSE(isCovariance(bad));
  bad = Matrix4d::Identity();
  bad(0, 1) = 0.5;
  EXPECT_FALSE(isCovariance(bad));
  bad(1, 0) = 0.5;
  EXPECT_TRUE(isCovariance(bad));
  bad(0, 1) = bad(1, 0) = 1.5;
  EXPECT_FALSE(isCovariance(bad));
  EXPECT_FALSE(isCovariance(Matrix4d::Zero()));
}

}  // namespace
}  // namespace ekf_tracker
