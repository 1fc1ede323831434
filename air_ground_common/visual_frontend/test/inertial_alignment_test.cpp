// Gravity, velocity and IMU biases from the metric poses of a camera in motion.
#include "visual_frontend/inertial_alignment.h"
#include "air_ground_common/units.h"

#include <gtest/gtest.h>

#include "air_ground_common/testing/random.h"

namespace visual_frontend {
namespace {

using air_ground_common::expSO3;
using air_ground_common::logSO3;
using air_ground_common::testing::Random;

using air_ground_common::kDegree;

/// A robot that never rests: sums of sines for position, heading and sway. The map's z is not up.
struct Motion {
  explicit Motion(unsigned seed) {
    Random random(seed);
    for (int i = 0; i < 3; ++i) {
      amplitude[i] = random.vector(0.6);
      frequency[i] = Eigen::Vector3d(random.uniform(0.3, 2.5), random.uniform(0.3, 2.5), random.uniform(0.3, 2.5));
      phase[i] = random.vector(M_PI);
    }
    yaw_rate = random.uniform(0.3, 0.6) * (random.uniform(-1, 1) > 0 ? 1 : -1);
    drift = random.vector(0.5);
    tilt = Eigen::Vector3d(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), 0);
    gyro_bias = random.vector(0.115);  // up to 0.2 rad/s
    accel_bias = random.vector(0.29);  // up to 0.5 m/s^2
    R_map_world = expSO3(tilt);
    T_camera_imu.linear() = expSO3(random.vector(1.7));
    T_camera_imu.translation() = random.vector(0.2);
  }

  Pose T_world_imu(double t) const {
    Pose T = Pose::Identity();
    Eigen::Vector3d sway = Eigen::Vector3d::Zero();
    T.translation() = drift * t;
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) {
        const double s = std::sin(frequency[i][k] * t + phase[i][k]);
        T.translation()[k] += amplitude[i][k] * s / 3;
        sway[k] += sway_amplitude * amplitude[(i + 1) % 3][k] * s;
      }
    }
    T.linear() = Eigen::AngleAxisd(yaw_rate * t, Eigen::Vector3d::UnitZ()) * expSO3(sway);
    return T;
  }

  ImuSample imu(double t, Random& random) const {
    constexpr double h = 1e-3;
    const Pose before = T_world_imu(t - h), now = T_world_imu(t), after = T_world_imu(t + h);
    ImuSample s;
    s.stamp = t;
    s.angular_velocity =
        logSO3(before.linear().transpose() * after.linear()) / (2 * h) + gyro_bias + random.gaussVector(0.004);
    const Eigen::Vector3d acceleration = (before.translation() + after.translation() - 2 * now.translation()) / (h * h);
    s.specific_force = now.linear().transpose() * (acceleration + Eigen::Vector3d(0, 0, kGravity)) + accel_bias +
                       random.gaussVector(0.06);
    return s;
  }

  Eigen::Vector3d amplitude[3], frequency[3], phase[3], drift, tilt, gyro_bias, accel_bias;
  double yaw_rate = 0.4, sway_amplitude = 0.05;
  Eigen::Matrix3d R_map_world;
  Pose T_camera_imu = Pose::Identity();
};

/// Feeds poses at 30 Hz with 2 mm and 1.5 mrad of noise, from the first sample on.
void run(const Motion& motion, InertialAlignment& alignment, double t0, double t1, unsigned seed) {
  Random random(seed);
  ImuBuffer imu;
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal() << Eigen::Vector3d::Constant(4e-6), Eigen::Vector3d::Constant(2.25e-6);
  double next_imu = t0;
  for (int i = 0; t0 + i / 30.0 <= t1; ++i) {
    const double t = t0 + i / 30.0;
    for (; next_imu <= t; next_imu += 0.005) imu.add(motion.imu(next_imu, random));
    Pose T = Pose(motion.R_map_world) * motion.T_world_imu(t) * motion.T_camera_imu.inverse();
    T.translation() += random.gaussVector(0.002);
    T.linear() = expSO3(random.gaussVector(0.0015)) * T.linear();
    alignment.addPose(t, T, covariance, imu);
  }
}

double tiltError(const InertialEstimate& e, const Motion& m) {
  return std::acos(std::clamp(e.up.dot(m.R_map_world.col(2)), -1.0, 1.0));
}

TEST(InertialAlignment, LevelWithinHalfADegreeFromMotionAlone) {
  double squares = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const Motion motion(seed);
    InertialAlignment alignment(motion.T_camera_imu);
    run(motion, alignment, 0, 8, seed);
    const auto e = alignment.estimate();
    ASSERT_TRUE(e);
    EXPECT_LT(tiltError(*e, motion), 0.5 * kDegree) << seed;
    EXPECT_LT(e->up_sigma, 0.25 * kDegree) << seed;
    EXPECT_LT((e->gyro_bias - motion.gyro_bias).norm(), 0.003) << seed;
    EXPECT_LT((e->accel_bias - motion.accel_bias).norm(), 0.12) << seed;
    squares += std::pow(tiltError(*e, motion) / e->up_sigma, 2) / 20;
  }
  // Two directions of tilt, none with more than the variance stated for the worst.
  EXPECT_LT(squares, 3.0);
  EXPECT_GT(squares, 0.05);
}

TEST(InertialAlignment, GyroBiasWithinASecond) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Motion motion(seed);
    InertialAlignment alignment(motion.T_camera_imu);
    run(motion, alignment, 0, 1, seed);
    const auto e = alignment.estimate();
    ASSERT_TRUE(e);
    EXPECT_LT((e->gyro_bias - motion.gyro_bias).norm(), 0.01) << seed;
    EXPECT_LT((e->gyro_bias - motion.gyro_bias).norm(), 5 * e->gyro_bias_sigma) << seed;
  }
}

TEST(InertialAlignment, WithoutRotationItSaysThatItDoesNotKnow) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Motion motion(seed);
    motion.yaw_rate = motion.sway_amplitude = 0;
    InertialAlignment alignment(motion.T_camera_imu);
    run(motion, alignment, 0, 20, seed);
    const auto e = alignment.estimate();
    ASSERT_TRUE(e);
    // The bias leans the vertical by up to 3 degrees, and nothing can tell.
    EXPECT_GT(e->up_sigma, 0.8 * kDegree) << seed;
    EXPECT_LT(tiltError(*e, motion), 3.5 * e->up_sigma) << seed;
    EXPECT_LT((e->gyro_bias - motion.gyro_bias).norm(), 0.003) << seed;
  }
}

TEST(InertialAlignment, FollowsTheMapAndBearsJumpsAndGaps) {
  const Motion motion(3);
  InertialAlignment alignment(motion.T_camera_imu);
  run(motion, alignment, 0, 8, 1);
  Pose S = Pose::Identity();
  S.linear() = motion.R_map_world.transpose();
  S.translation() = Eigen::Vector3d(3, -2, 1);
  alignment.transform(S);
  EXPECT_GT(alignment.estimate()->up.z(), std::cos(0.5 * kDegree));
  alignment.interrupt();
  EXPECT_GT(alignment.estimate()->up.z(), std::cos(0.5 * kDegree));
  // Goes on elsewhere, in the levelled map, without having been told of the jump in position.
  Motion level = motion;
  level.R_map_world.setIdentity();
  run(level, alignment, 12, 14, 2);
  run(level, alignment, 15.5, 20, 3);
  const auto e = alignment.estimate();
  EXPECT_LT(tiltError(*e, level), 0.3 * kDegree);
  EXPECT_LT((e->accel_bias - motion.accel_bias).norm(), 0.12);
  alignment.reset();
  EXPECT_FALSE(alignment.estimate());
}

TEST(InertialAlignment, RefusesBadSettings) {
  InertialAlignmentSettings bad;
  bad.initial_accel_bias = 0;
  EXPECT_THROW(InertialAlignment(Pose::Identity(), bad), std::invalid_argument);
}

}  // namespace
}  // namespace visual_frontend
