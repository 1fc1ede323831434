// The vertical of a MAV whose odometry knows nothing of gravity, against a flight whose attitude is known.
#include "ekf_tracker/tilt_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "air_ground_common/geometry.h"
#include "air_ground_common/linear_algebra.h"
#include "ekf_tracker/pose_filter.h"

namespace ekf_tracker {
namespace {

constexpr double kStep = 0.05;

// In a level frame: turns on its way, nods and rolls.
Eigen::Matrix3d attitude(double t) {
  return (Eigen::AngleAxisd(0.3 * t, Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(0.2 + 0.1 * std::sin(0.7 * t), Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(0.1 * std::cos(0.4 * t), Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

Eigen::Vector3d upInBody(double t) { return attitude(t).row(2).transpose(); }

void fly(double from, double to, TiltFilter* filter) {
  for (int i = static_cast<int>(std::lround(from / kStep)); i < std::lround(to / kStep); ++i)
    filter->turn(i * kStep, (i + 1) * kStep, attitude(i * kStep).transpose() * attitude((i + 1) * kStep));
}

// Angle of the vertical [rad].
double error(const Tilt& tilt, double t) {
  const Eigen::Vector3d up = tilt.R_level_body.row(2).transpose();
  return std::acos(std::min(1.0, up.dot(upInBody(t))));
}

TEST(TiltFilter, TurnsCarryAFixesAttitudeAlong) {
  TiltFilter filter;
  fly(0, 10, &filter);
  EXPECT_FALSE(filter.at(10));
  filter.addVertical({4, upInBody(4), 0.01});  // late by six seconds
  ASSERT_TRUE(filter.at(10));
  EXPECT_LT(error(*filter.at(10), 10), 1e-6);
  EXPECT_LT(error(*filter.at(7), 7), 1e-6);
  EXPECT_NEAR(air_ground_common::yawOf(filter.at(10)->R_level_body), 0, 1e-9);
  EXPECT_FALSE(filter.at(10.2));
  EXPECT_TRUE(filter.at(10.2, 0.3));

  TiltFilter early;
  early.addVertical({4, upInBody(4), 0.01});
  fly(0, 10, &early);
  ASSERT_TRUE(early.at(10));
  EXPECT_LT(error(*early.at(10), 10), 1e-6);
}

TEST(TiltFilter, WhereTheOdometryPausedTheVerticalIsForgotten) {
  TiltFilter filter;
  fly(0, 10, &filter);
  filter.addVertical({10, upInBody(10), 0.01});
  fly(12, 14, &filter);
  EXPECT_FALSE(filter.at(14));
  filter.addVertical({13, upInBody(13), 0.01});
  ASSERT_TRUE(filter.at(14));
  EXPECT_LT(error(*filter.at(14), 14), 1e-6);
  filter.turn(13.9, 13.95, Eigen::Matrix3d::Identity());  // once more
  EXPECT_TRUE(filter.at(14));
  fly(0, 2, &filter);  // a looped bag
  EXPECT_FALSE(filter.at(2));
}

// A slalom that lasts: the accelerometer's low-pass of a second takes 1.2 m/s^2 for 7 degrees.
TEST(TiltFilter, AccelerationsInFlightAverageOut) {
  TiltFilter filter;
  double worst = 0;
  for (int i = 0; i < 6000; ++i) {
    const double t = 0.01 * i;
    const Eigen::Vector3d acceleration(1.2 * std::sin(0.8 * t), 0.8 * std::cos(1.1 * t), 0.5 * std::sin(2 * t));
    filter.addSpecificForce(t, attitude(t).transpose() * (acceleration + Eigen::Vector3d(0, 0, 9.81)));
    if (i % 5 == 0) fly(t, t + kStep, &filter);
    if (t < 20 || i % 5 != 0) continue;
    const auto tilt = filter.at(t);
    ASSERT_TRUE(tilt);
    worst = std::max(worst, error(*tilt, t));
  }
  EXPECT_LT(worst, 0.025);
}

// The bias of consumer hardware. It is stated, until fixes see it.
TEST(TiltFilter, ABiasedAccelerometerIsNotBelievedMoreTheLongerItTells) {
  TiltFilter filter;
  const Eigen::Vector3d bias(0.3, -0.1, 0.1);
  for (int i = 0; i < 2400; ++i) {
    const double t = kStep * i;
    filter.addSpecificForce(t, Eigen::Vector3d(0, 0, 9.81) + bias);
    filter.turn(t, t + kStep, Eigen::Matrix3d::Identity());
  }
  const auto leans = [&] { return std::acos(filter.at(120)->R_level_body(2, 2)); };
  EXPECT_NEAR(leans(), 0.032, 0.004);
  EXPECT_GT(filter.at(120)->stddev, 0.03);
  for (int i = 0; i < 3; ++i) filter.addVertical({118.5 + 0.5 * i, Eigen::Vector3d::UnitZ(), 0.01});
  EXPECT_LT(leans(), 0.006);
  EXPECT_LT(filter.at(120)->stddev, 0.02);
}

TEST(TiltFilter, ManyFixesThatErrAlikeTellNoMoreThanOne) {
  TiltFilter filter;
  fly(0, 60, &filter);
  for (int i = 1; i <= 60; ++i) filter.addVertical({double(i), upInBody(i), 0.02});
  EXPECT_GE(filter.at(60)->stddev, 0.01);
}

TEST(TiltFilter, AfterAShortPauseTheVerticalIsKnownLessWell) {
  TiltFilter filter;
  fly(0, 10, &filter);
  filter.addVertical({10, upInBody(10), 0.01});
  const double before = filter.at(10)->stddev;
  fly(10.2, 12, &filter);  // and in the pause it turns, which nobody tells
  ASSERT_TRUE(filter.at(12));
  EXPECT_GT(filter.at(12)->stddev, before + 0.03);
  EXPECT_LT(error(*filter.at(12), 12), 2 * filter.at(12)->stddev);
}

TEST(TiltFilter, OneFixThatIsOffCountsLittle) {
  TiltFilter forces;
  for (int i = 0; i < 60; ++i) {
    forces.addSpecificForce(kStep * i, attitude(kStep * i).transpose() * Eigen::Vector3d(0, 0, 9.81));
    fly(kStep * i, kStep * (i + 1), &forces);
  }
  forces.addVertical({3, attitude(3).transpose() * Eigen::Vector3d(0.5, 0, 0.9), 0.01});
  EXPECT_LT(error(*forces.at(3), 3), 0.02) << "after two seconds of forces";

  TiltFilter filter;
  fly(0, 20, &filter);
  for (int i = 1; i < 20; ++i) filter.addVertical({double(i), upInBody(i), 0.01});
  const double before = error(*filter.at(20), 20);
  filter.addVertical({20, attitude(20).transpose() * Eigen::Vector3d(0.5, 0, 0.9), 0.01});
  EXPECT_LT(error(*filter.at(20), 20), before + 0.005);
}

TEST(TiltFilter, AFirstFixThatIsOffIsGivenUp) {
  TiltFilter filter;
  filter.addVertical({0, attitude(0).transpose() * Eigen::Vector3d(0.4, 0, 0.9), 0.01});
  for (int i = 1; i <= 5; ++i) {
    fly(i - 1, i, &filter);
    filter.addVertical({double(i), upInBody(i), 0.01});
  }
  EXPECT_LT(error(*filter.at(5), 5), 1e-6);
}

TEST(TiltFilter, ItsDeviationIsThatOfItsError) {
  std::mt19937 rng(5);
  std::normal_distribution<double> normal;
  double squares = 0;
  constexpr int kRuns = 200;
  for (int run = 0; run < kRuns; ++run) {
    TiltFilter filter;
    Eigen::Vector3d drift = Eigen::Vector3d::Zero();
    for (int i = 0; i < 400; ++i) {
      const double t = i * kStep;
      for (int k = 0; k < 3; ++k) drift[k] = 0.002 * std::sqrt(kStep) * normal(rng);
      filter.turn(t, t + kStep, attitude(t).transpose() * attitude(t + kStep) * air_ground_common::expSO3(drift));
      if (i % 20) continue;
      const Eigen::Vector3d off(0.03 * normal(rng), 0.03 * normal(rng), 0);
      filter.addVertical({t + kStep,
                          attitude(t + kStep).transpose() * air_ground_common::expSO3(off) * Eigen::Vector3d(0, 0, 1),
                          0.03});
    }
    const auto tilt = filter.at(20);
    ASSERT_TRUE(tilt);
    // These fixes do not err alike, for which 0.01 rad are stated beside.
    squares += std::pow(error(*tilt, 20), 2) / (tilt->stddev * tilt->stddev - 1e-4) / kRuns;
  }
  EXPECT_NEAR(squares, 2, 0.5);  // two axes
}

// A tilt d lifts the way by d x motion, and stays: over 20 s its parts add up as of one.
TEST(TiltNoise, ATiltThatIsOffIsPartOfThePrediction) {
  FilterSettings settings;
  Increment step;
  step.stamp = 0.05;
  step.covariance = 1e-12 * Matrix4d::Identity();
  step.motion << 0.1, 0.2, 0, 0;
  const Matrix4d before = noiseOf(step, settings);
  step.tilt_stddev = 0.1;
  Matrix4d added = noiseOf(step, settings) - before;
  EXPECT_NEAR(added(2, 2), 0.1 * 0.1 * 0.05 * kTiltStays / 0.05, 1e-9);
  added(2, 2) = 0;
  EXPECT_LT(added.norm(), 1e-12);
  Increment first, second;
  split(step, 0.02, &first, &second);
  EXPECT_NEAR(noiseOf(first, settings)(2, 2) + noiseOf(second, settings)(2, 2), noiseOf(step, settings)(2, 2), 1e-9);
}

}  // namespace
}  // namespace ekf_tracker
