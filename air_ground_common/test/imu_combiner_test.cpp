#include "air_ground_common/imu_combiner.h"

#include <gtest/gtest.h>

#include <vector>

namespace air_ground_common {
namespace {

/// The force rises by 1 m/s^2 each second along x; the gyro turns at its stamp's rate about z.
void feed(ImuCombiner& combiner, double from, double to, std::vector<ImuCombiner::Sample>* samples) {
  double next_gyro = from, next_force = from + 0.002;
  for (double t = from; t < to; t += 0.001) {
    if (t >= next_gyro) {
      combiner.addGyro(next_gyro, {0, 0, next_gyro});
      next_gyro += 0.005;
    }
    if (t >= next_force) {
      combiner.addAccelerometer(next_force, {next_force, 0, 9.81});
      next_force += 0.016;
    }
    while (const auto sample = combiner.pop()) samples->push_back(*sample);
  }
}

TEST(ImuCombiner, InterpolatesTheForceAtTheGyrosStamps) {
  ImuCombiner combiner;
  std::vector<ImuCombiner::Sample> samples;
  feed(combiner, 10, 11, &samples);
  ASSERT_GT(samples.size(), 190u);
  EXPECT_NEAR(samples.front().stamp, 10.005, 1e-9) << "the first is older than any force";
  for (std::size_t i = 0; i < samples.size(); ++i) {
    EXPECT_NEAR(samples[i].angular_velocity.z(), samples[i].stamp, 1e-12);
    EXPECT_NEAR(samples[i].specific_force.x(), samples[i].stamp, 1e-9);
    EXPECT_NEAR(samples[i].specific_force.z(), 9.81, 1e-12);
    if (i > 0) EXPECT_NEAR(samples[i].stamp - samples[i - 1].stamp, 0.005, 1e-9);
  }
}

TEST(ImuCombiner, BeginsAfreshWhereTheRecordingIsPlayedAgain) {
  ImuCombiner combiner;
  std::vector<ImuCombiner::Sample> samples;
  feed(combiner, 10, 12, &samples);
  samples.clear();
  feed(combiner, 10, 10.5, &samples);
  ASSERT_GT(samples.size(), 80u);
  EXPECT_LT(samples.front().stamp, 10.02);
  EXPECT_NEAR(samples.front().specific_force.x(), samples.front().stamp, 1e-9);
  combiner.addGyro(10.2, {0, 0, 7});  // out of order
  combiner.addAccelerometer(10.6, {10.6, 0, 9.81});
  while (const auto sample = combiner.pop()) EXPECT_NE(sample->angular_velocity.z(), 7);
}

}  // namespace
}  // namespace air_ground_common
