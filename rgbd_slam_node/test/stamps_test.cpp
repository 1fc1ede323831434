// Stamps of other clocks, and of drivers that jitter.
#include <gtest/gtest.h>

#include <algorithm>
#include <deque>

#include "air_ground_common/linear_algebra.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::Robot;
using simulated::synthetic::Random;

TEST(Slam, ImuClockAheadOfTheCamera) {
  Robot robot;
  robot.sway = 0.06;
  robot.sway_rate = 2;
  // The same samples with stamps 50 ms ahead, and the setting that says so: the same results.
  constexpr double kOffset = 0.05;
  SlamSettings told;
  told.time_offset = kOffset;
  Slam plain(robot.camera, robot.mounting, {}), corrected(robot.camera, robot.mounting, told),
      untold(robot.camera, robot.mounting, {});
  Random random(11);
  double next_imu = 0;
  std::deque<visual_frontend::ImuSample> shifted;
  SlamResult a, b;
  for (int i = 0; i <= 50; ++i) {
    const double t = 0.1 * i;
    for (; next_imu <= t + 0.005; next_imu += 0.005) {
      auto sample = robot.imu(next_imu, random);
      plain.addImu(sample);
      sample.stamp += kOffset;
      corrected.addImu(sample);
      untold.addImu(sample);
    }
    const auto frame = robot.frame(t, random);
    a = plain.process(t, frame.gray, cv::Mat(), frame.depth);
    b = corrected.process(t, frame.gray, cv::Mat(), frame.depth);
    untold.process(t, frame.gray, cv::Mat(), frame.depth);
  }
  EXPECT_LT((a.T_map_base.translation() - b.T_map_base.translation()).norm(), 2e-3);
  EXPECT_LT(air_ground_common::rotationAngle(a.T_map_base.linear(), b.T_map_base.linear()), 1e-3);
  const double bias_error = (corrected.gyroBias() - robot.gyro_bias).norm();
  EXPECT_LT(bias_error, 0.006);
  EXPECT_GT((untold.gyroBias() - robot.gyro_bias).norm(), 2 * bias_error);
}

// A driver stamps some images 95 of 100 ms late: the step to the next one is no leap.
TEST(Slam, StampsThatJitterAreNoLeaps) {
  Robot robot;
  SlamSettings settings;
  settings.max_speed = 2;
  Slam slam(robot.camera, robot.mounting, settings);
  Random random(2);
  double fastest = 0;
  for (int i = 0; i < 60; ++i) {
    const double t = 0.1 * i;
    const auto frame = robot.frame(t, random);
    const SlamResult r = slam.process(t + (i % 10 == 5 ? 0.095 : 0), frame.gray, cv::Mat(), frame.depth);
    if (t > 1.5) {  // without IMU the map begins later
      EXPECT_EQ(r.state, State::kTracking) << i << ": " << r.reason;
      EXPECT_FALSE(r.relocalized) << i;
    }
    if (i > 0)
      fastest = std::max(fastest, (robot.mapped(t).translation() - robot.mapped(t - 0.1).translation()).norm());
  }
  ASSERT_GT(fastest / 0.005, 2 * settings.max_speed);
  EXPECT_EQ(slam.counters().lost_frames, 0);
}

}  // namespace
}  // namespace rgbd_slam
