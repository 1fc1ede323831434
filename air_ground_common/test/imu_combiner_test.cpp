#include "air_ground_common/imu_combiner.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "air_ground_common/packet_spreader.h"
#include "air_ground_common/range_end.h"

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
    if (i > 0) {
      EXPECT_NEAR(samples[i].stamp - samples[i - 1].stamp, 0.005, 1e-9);
    }
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

/// What comes of samples of 200 Hz whose stamps are `stampOf` their number.
template <typename StampOf>
std::vector<double> spreadStamps(int count, const StampOf& stampOf) {
  PacketSpreader<ImuCombiner::Sample> spreader;
  std::vector<double> stamps;
  for (int i = 0; i < count; ++i)
    for (const auto& sample : spreader.add({stampOf(i), {0, 0, static_cast<double>(i)}, {}}))
      stamps.push_back(sample.stamp);
  return stamps;
}

TEST(PacketSpreader, SpreadsPacketsOverTheTimeSinceTheOneBefore) {
  for (const int packet : {2, 4, 10})
    for (const double within : {0.0, 1e-5, 2e-4}) {
      const auto arrival = [&](int i) { return 5 + 0.005 * packet * (i / packet + 1) + within * (i % packet); };
      const std::vector<double> stamps = spreadStamps(400, arrival);
      ASSERT_GE(stamps.size(), 400u - packet);
      for (std::size_t i = 141; i < stamps.size(); ++i) EXPECT_NEAR(stamps[i] - stamps[i - 1], 0.005, 2e-4) << packet;
      EXPECT_NEAR(stamps[300], 5 + 0.005 * 301, within * packet + 1e-9) << "measured at the latest when it arrived";
    }
}

TEST(PacketSpreader, LeavesOthersAsTheyAre) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::vector<double> jittery;
  for (int i = 0; i < 2000; ++i) jittery.push_back(0.005 * i + 0.001 * normal(random));
  std::sort(jittery.begin(), jittery.end());
  for (const auto& told : {jittery, [] {
                             std::vector<double> gaps;  // every third lost, one in twenty doubled, and a pause
                             for (int i = 0; i < 2000; ++i)
                               if (i % 3) gaps.insert(gaps.end(), i % 20 ? 1 : 2, 0.005 * i + (i > 900 ? 2 : 0));
                             return gaps;
                           }()}) {
    EXPECT_EQ(spreadStamps(static_cast<int>(told.size()), [&](int i) { return told[i]; }), told);
  }
}

/// Share of 20,000 readings of normally distributed vibration that are said to lie at the end of the range.
double shareAtEnd(double sigma, double end, double step) {
  std::mt19937 random(11);
  std::normal_distribution<double> vibration(0, sigma);
  RangeEnd range(18);
  int at_end = 0;
  for (int i = 0; i < 20000; ++i) {
    const double x = step * std::round(vibration(random) / step);
    at_end += range.reached({0.1, std::clamp(x, -end, end), 9.81});
  }
  return at_end / 20000.0;
}

TEST(RangeEnd, IsWhereReadingsAreCutOff) {
  EXPECT_NEAR(shareAtEnd(30, 39.2266, 0.0012), 0.191, 0.01);       // beyond 1.31 sigma
  EXPECT_NEAR(shareAtEnd(13.07, 39.2266, 0.0012), 0.0027, 0.001);  // beyond 3 sigma
}

TEST(RangeEnd, IsNotWhereTheMotionEnds) {
  for (const double step : {1e-9, 0.0048, 0.15}) EXPECT_EQ(shareAtEnd(8, 1e9, step), 0) << step;
  RangeEnd even(18), still(18);
  for (int i = 0; i < 5000; ++i) {
    EXPECT_FALSE(even.reached({0, 0, 9.81 + 12 * std::sin(0.37 * i)})) << "a steady vibration dwells at its ends";
    EXPECT_FALSE(still.reached({0, 0, 9.81}));
  }
}

}  // namespace
}  // namespace air_ground_common
