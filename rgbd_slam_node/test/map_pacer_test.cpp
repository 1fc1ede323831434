// When ground clouds go out: by hand-computed times.
#include "../src/map_pacer.h"

#include <gtest/gtest.h>

#include <vector>

namespace rgbd_slam {
namespace {

constexpr double kLarge = 8e6;  // [bytes]: 8 s at the bandwidth

struct Pacer : ::testing::Test {
  /// Times at which clouds go out of a map that changes ten times a second [s].
  std::vector<double> sent(double seconds, double bytes, bool corrected = false) {
    std::vector<double> times;
    for (int i = 0; i <= 10 * seconds; ++i) {
      const double now = 1000 + 0.1 * i;
      pacer.changed(corrected);
      if (!pacer.due(now, bytes)) continue;
      pacer.sent(now, bytes);
      times.push_back(0.1 * i);
    }
    return times;
  }
  MapPacer pacer{2, 1e6};
};

TEST_F(Pacer, WhatHasNotChangedIsNotSentAgain) {
  EXPECT_FALSE(pacer.due(0, 1));
  pacer.changed(false);
  EXPECT_TRUE(pacer.due(0, 1));
  pacer.sent(0, 1);
  EXPECT_FALSE(pacer.due(1000, 1));
}

TEST_F(Pacer, SmallCloudsKeepTheInterval) { EXPECT_EQ(sent(6, 5e5), (std::vector<double>{0, 2, 4, 6})); }

TEST_F(Pacer, LargeOnesComeAsTheLineCarriesThem) { EXPECT_EQ(sent(25, kLarge), (std::vector<double>{0, 8, 16, 24})); }

TEST_F(Pacer, ACorrectedMapIsSentAtOnceAndTheNextCloudWaitsForIt) {
  pacer.sent(0, kLarge);
  pacer.changed(false);
  EXPECT_FALSE(pacer.due(7.9, kLarge));
  pacer.changed(true);
  ASSERT_TRUE(pacer.due(0.1, kLarge));
  pacer.sent(0.1, kLarge);
  pacer.changed(false);
  EXPECT_FALSE(pacer.due(15.9, kLarge));
  EXPECT_TRUE(pacer.due(16, kLarge));
  pacer.changed(true);
  EXPECT_FALSE(pacer.due(7.9, kLarge)) << "one ahead of its time, not two";
  EXPECT_TRUE(pacer.due(8, kLarge));
}

TEST_F(Pacer, CorrectionsWithoutEndStayWithinTheBandwidth) {
  EXPECT_EQ(sent(25, kLarge, true), (std::vector<double>{0, 0.1, 8, 16, 24}));
}

TEST_F(Pacer, TheLastCloudOfARecordingWaitsForNothing) {
  pacer.sent(1000, kLarge);
  pacer.changed(false);
  pacer.hurry();
  EXPECT_TRUE(pacer.due(1000, kLarge));
}

TEST_F(Pacer, AnotherMapOwesNothingAndHasNothingYet) {
  pacer.sent(1000, kLarge);
  pacer.changed(true);
  pacer.restart();
  EXPECT_FALSE(pacer.due(5, 0));
  pacer.changed(false);
  EXPECT_TRUE(pacer.due(5, 0));
}

}  // namespace
}  // namespace rgbd_slam
