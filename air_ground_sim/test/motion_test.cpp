// Spline derivatives, physical attitude, and an inertial unit whose readings integrate back to the trajectory.
#include <gtest/gtest.h>

#include <cmath>

#include "air_ground_sim/sensors.h"
#include "air_ground_sim/trajectory.h"

namespace air_ground_sim {
namespace {

using air_ground_common::Pose;

BodyTrajectory testFlight(std::uint64_t seed) {
  FlightConfig c;
  c.duration = 20;
  return makeFlight(
      c, {2.0, -1.5}, [](const Eigen::Vector2d&, double) { return 0.4; }, seed);
}

TEST(QuinticSpline, DerivativesMatchFiniteDifferences) {
  Rng rng(3);
  std::vector<Eigen::Vector4d> control;
  for (int i = 0; i < 20; ++i) control.emplace_back(rng.gaussian(), rng.gaussian(), rng.gaussian(), rng.gaussian());
  const QuinticSpline s(control, 1.0, 0.3);
  const double h = 1e-4;
  for (int k = 0; k < 200; ++k) {
    const double t = rng.uniform(s.begin() + 0.01, s.end() - 0.01);
    for (int d = 0; d < 4; ++d) {
      const Eigen::Vector4d difference = (s.evaluate(t + h, d) - s.evaluate(t - h, d)) / (2 * h);
      const Eigen::Vector4d derivative = s.evaluate(t, d + 1);
      EXPECT_LT((difference - derivative).norm(), 1e-3 * (1 + derivative.norm()))
          << "derivative " << d + 1 << " at " << t;
    }
  }
}

TEST(QuinticSpline, FourthDerivativeIsContinuousAtKnots) {
  Rng rng(4);
  std::vector<Eigen::Vector4d> control;
  for (int i = 0; i < 12; ++i) control.emplace_back(rng.gaussian(), rng.gaussian(), rng.gaussian(), rng.gaussian());
  const QuinticSpline s(control, 0.0, 0.5);
  for (int knot = 1; knot < 7; ++knot)
    EXPECT_LT((s.evaluate(0.5 * knot - 1e-9, 4) - s.evaluate(0.5 * knot + 1e-9, 4)).norm(),
              1e-3 * s.evaluate(0.5 * knot, 4).norm() + 1e-3);
}

TEST(QuinticSpline, RefusesTooFewPoints) {
  EXPECT_THROW(QuinticSpline(std::vector<Eigen::Vector4d>(5, Eigen::Vector4d::Zero()), 0, 1), std::invalid_argument);
}

TEST(Flight, StandsStillThenFliesAsAsked) {
  for (std::uint64_t seed : {1, 2, 3}) {
    const BodyTrajectory flight = testFlight(seed);
    EXPECT_LT(flight.pathLength(0, 1.0), 1e-9);
    EXPECT_NEAR(flight.pathLength(0, 20), 0.42 * (20 - 1.5 - 1.0), 0.3);
    double acceleration2 = 0, highest = 0;
    for (double t = 3; t < 20; t += 0.01) {
      const BodyState s = flight.state(t);
      EXPECT_LT(s.velocity.norm(), 1.3);
      EXPECT_LT(s.acceleration.norm(), 3.0);
      acceleration2 += s.acceleration.squaredNorm() / 1700;
      highest = std::max(highest, s.T_world_body.translation().z());
    }
    EXPECT_GT(std::sqrt(acceleration2), 0.35) << "the scale is not observable without acceleration";
    EXPECT_GT(highest, 1.6);
    EXPECT_LT(highest, 3.0);
  }
}

TEST(Flight, TiltsIntoItsAcceleration) {
  const BodyTrajectory flight = testFlight(5);
  for (double t = 2; t < 19; t += 0.37) {
    const BodyState s = flight.state(t);
    const Eigen::Vector3d thrust = s.acceleration + Eigen::Vector3d(0, 0, kGravity);
    EXPECT_LT(s.T_world_body.linear().col(2).cross(thrust.normalized()).norm(), 1e-12);
    EXPECT_TRUE(air_ground_common::isValid(s.T_world_body));
  }
}

TEST(Flight, AngularVelocityMatchesRotations) {
  const BodyTrajectory flight = testFlight(6);
  const double h = 1e-5;
  for (double t = 1; t < 19; t += 0.173) {
    const Eigen::Matrix3d step = flight.pose(t - h).linear().transpose() * flight.pose(t + h).linear();
    EXPECT_LT((air_ground_common::logSO3(step) / (2 * h) - flight.state(t).angular_velocity).norm(), 1e-5);
  }
}

// Strapdown integration with the midpoint rule, from the true initial state.
TEST(Imu, NoiselessReadingsIntegrateBackToTheTrajectory) {
  const BodyTrajectory flight = testFlight(7);
  Pose T_base_imu = Pose::Identity();
  T_base_imu.linear() = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  T_base_imu.translation() = Eigen::Vector3d(0.2, -0.1, 0.15);  // a lever arm that matters
  const Imu imu(ImuConfig(), T_base_imu, 1);
  const Pose start = flight.pose(0) * T_base_imu;
  Eigen::Matrix3d R = start.linear();
  Eigen::Vector3d p = start.translation(), v = Eigen::Vector3d::Zero();
  const double dt = 0.001;
  for (int i = 0; i < 15000; ++i) {
    const ImuReading r = imu.truth(flight.state((i + 0.5) * dt));
    const Eigen::Matrix3d R_mid = R * air_ground_common::expSO3(0.5 * dt * r.angular_velocity);
    const Eigen::Vector3d a = R_mid * r.specific_force - Eigen::Vector3d(0, 0, kGravity);
    p += dt * v + 0.5 * dt * dt * a;
    v += dt * a;
    R = R * air_ground_common::expSO3(dt * r.angular_velocity);
  }
  const Pose end = flight.pose(15.0) * T_base_imu;
  EXPECT_LT(air_ground_common::rotationAngle(R, end.linear()), 1e-4);
  EXPECT_LT((p - end.translation()).norm(), 0.01);
}

TEST(Imu, MeasuresPlusGravityOnZAtRest) {
  const Imu imu(ImuConfig(), Pose::Identity(), 1);
  const ImuReading r = imu.truth(testFlight(1).state(0.2));
  EXPECT_LT((r.specific_force - Eigen::Vector3d(0, 0, kGravity)).norm(), 1e-9);
  EXPECT_LT(r.angular_velocity.norm(), 1e-9);
}

TEST(Imu, NoiseHasTheDensityAsked) {
  ImuConfig c;
  c.gyro_bias = c.accel_bias = c.gyro_bias_walk = c.accel_bias_walk = 0;
  Imu imu(c, Pose::Identity(), 9);
  const BodyState rest;
  double gyro2 = 0, accel2 = 0;
  const int n = 20000;
  for (int i = 0; i < n; ++i) {
    const ImuReading r = imu.measure(rest);
    gyro2 += r.angular_velocity.squaredNorm() / (3 * n);
    accel2 += (r.specific_force - Eigen::Vector3d(0, 0, kGravity)).squaredNorm() / (3 * n);
  }
  EXPECT_NEAR(std::sqrt(gyro2), c.gyro_noise * std::sqrt(200), 0.02 * c.gyro_noise * std::sqrt(200));
  EXPECT_NEAR(std::sqrt(accel2), c.accel_noise * std::sqrt(200), 0.02 * c.accel_noise * std::sqrt(200));
}

TEST(Imu, BiasWalksAsAsked) {
  ImuConfig c;
  c.gyro_bias = c.accel_bias = 0;
  const BodyState rest;
  double gyro2 = 0, accel2 = 0;
  const int runs = 400, steps = 400;  // 2 s each
  for (int k = 0; k < runs; ++k) {
    Imu imu(c, Pose::Identity(), 100 + k);
    for (int i = 0; i < steps; ++i) imu.measure(rest);
    gyro2 += imu.gyroBias().squaredNorm() / (3 * runs);
    accel2 += imu.accelBias().squaredNorm() / (3 * runs);
  }
  EXPECT_NEAR(std::sqrt(gyro2), c.gyro_bias_walk * std::sqrt(2.0), 0.1 * c.gyro_bias_walk * std::sqrt(2.0));
  EXPECT_NEAR(std::sqrt(accel2), c.accel_bias_walk * std::sqrt(2.0), 0.1 * c.accel_bias_walk * std::sqrt(2.0));
}

TEST(Drive, FollowsTheLaneLevelAndFacesTheScene) {
  LaneConfig lane;
  lane.points = {{2.5, -1.2}, {2.7, 0.2}, {2.3, 1.6}, {1.2, 2.5}, {-0.3, 2.7}, {-1.7, 2.3}};
  const BodyTrajectory drive = makeDrive(lane, 30, 3);
  EXPECT_LT(drive.pathLength(0, 0.5), 1e-9);
  EXPECT_LT((drive.pose(0).translation().head<2>() - lane.points.front()).norm(), 1e-6);
  EXPECT_LT((drive.pose(30).translation().head<2>() - lane.points.back()).norm(), 0.02);
  for (double t = 0; t <= 30; t += 0.5) {
    const Pose T = drive.pose(t);
    EXPECT_EQ(T.translation().z(), 0.0);
    const Eigen::Vector2d to_scene = -T.translation().head<2>();
    const double off =
        air_ground_common::wrapAngle(air_ground_common::yawOf(T.linear()) - std::atan2(to_scene.y(), to_scene.x()));
    EXPECT_LT(std::abs(off), lane.heading_swing + 0.05);
  }
}

}  // namespace
}  // namespace air_ground_sim
