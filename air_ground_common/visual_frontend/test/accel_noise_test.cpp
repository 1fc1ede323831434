// The accelerometer's noise where vibration folds into the band of motion, and none where it does not.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <utility>

#include "visual_frontend/accel_noise.h"

namespace visual_frontend {
namespace {

/// Feeds `seconds` of samples at `rate` [Hz] of `force` (time -> m/s^2), white noise of `density` added.
template <typename Force>
double measured(double rate, double seconds, double density, const Force& force) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal(0, density * std::sqrt(rate));
  AccelNoise noise;
  for (int i = 0; i < seconds * rate; ++i) {
    const double t = 1e9 + i / rate;
    const Eigen::Vector3d white(normal(random), normal(random), normal(random));
    noise.add(t, force(i / rate) + white);
  }
  return noise.density();
}

Eigen::Vector3d still(double) { return {0, 0, 9.81}; }

TEST(AccelNoise, WhiteNoiseHasItsDensity) {
  for (const double rate : {50.0, 66.0, 100.0, 200.0, 400.0, 1000.0})
    for (const double density : {0.004, 0.1})
      EXPECT_NEAR(measured(rate, 20, density, still), density, (rate < 150 ? 0.3 : 0.2) * density) << rate << " Hz";
}

// As RealSense's driver unites both sensors, and ImuCombiner: half of the noise was found in them.
TEST(AccelNoise, InterpolatedReadingsHaveTheNoiseOfThoseBetweenWhichTheyLie) {
  for (const double accel_rate : {63.0, 66.7, 100.0, 250.0}) {
    for (const double gyro_rate : {200.0, 400.0}) {
      std::mt19937 random(9);
      const double density = 0.1;
      std::normal_distribution<double> normal(0, density * std::sqrt(accel_rate));
      const auto reading = [&] { return Eigen::Vector3d(normal(random), normal(random), 9.81 + normal(random)); };
      AccelNoise noise;
      Eigen::Vector3d before = reading(), after = reading();
      double next = 1 / accel_rate;
      for (int i = 0; i < 20 * gyro_rate; ++i) {
        const double t = i / gyro_rate;
        while (next < t) {
          before = std::exchange(after, reading());
          next += 1 / accel_rate;
        }
        const double a = (next - t) * accel_rate;
        noise.add(1.7e9 + t, a * before + (1 - a) * after);
      }
      EXPECT_NEAR(noise.density(), density, 0.25 * density) << accel_rate << " Hz at " << gyro_rate << " Hz";
    }
  }
}

TEST(AccelNoise, MotionIsNoNoise) {
  const auto flown = [](double t) {
    return Eigen::Vector3d(2 * std::sin(2 * M_PI * 0.7 * t), 3 * std::sin(2 * M_PI * 2 * t),
                           9.81 + std::sin(2 * M_PI * 4 * t));
  };
  EXPECT_LT(measured(200, 10, 1e-6, flown), 0.002);
}

TEST(AccelNoise, ABumpIsNoNoise) {
  const auto bumped = [](double t) { return Eigen::Vector3d(0, std::abs(t - 7) < 0.01 ? 30 : 0, 9.81); };
  EXPECT_NEAR(measured(200, 8, 0.004, bumped), 0.004, 0.001);
}

TEST(AccelNoise, ATakeOffIsNoticedWithinThreeSeconds) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  AccelNoise noise;
  for (int i = 0; i < 66 * 13; ++i) {
    const double sigma = i < 66 * 10 ? 0.01 : 1;  // [m/s^2]
    noise.add(i / 66.0, sigma * Eigen::Vector3d(normal(random), normal(random), normal(random)));
  }
  EXPECT_GT(noise.density(), 0.05);
}

TEST(AccelNoise, VibrationCountsWhereItIsFoldedDown) {
  // A rotor that changes its speed: 60 to 90 Hz, 1.4 m/s^2.
  const auto vibrating = [](double t) {
    const double phase = 2 * M_PI * (75 * t + 15 * 0.5 * std::sin(2 * t));
    return Eigen::Vector3d(1.4 * std::sin(phase), 1.4 * std::cos(phase), 9.81 + std::sin(phase + 1));
  };
  EXPECT_LT(measured(1000, 10, 1e-6, vibrating), 0.01);
  EXPECT_LT(measured(400, 10, 1e-6, vibrating), 0.01);
  EXPECT_GT(measured(66, 10, 1e-6, vibrating), 0.03);
}

TEST(AccelNoise, NothingAtFirstNorAcrossAGap) {
  EXPECT_EQ(measured(200, 0.2, 0.1, still), 0);
  EXPECT_GT(measured(200, 0.5, 0.1, still), 0.05);
  AccelNoise noise;
  for (int i = 0; i < 400; ++i) {
    // A leap during the gap would be noise of 10 m/s^2.
    noise.add(i * 0.005 + (i < 200 ? 0 : 5), Eigen::Vector3d(i < 200 ? 0 : 10, 0, 9.81));
    noise.add(i * 0.005 + (i < 200 ? 0 : 5), Eigen::Vector3d(5, 0, 0));  // no later: dropped
  }
  EXPECT_LT(noise.density(), 1e-9);
  noise.reset();
  EXPECT_EQ(noise.density(), 0);
}

}  // namespace
}  // namespace visual_frontend
