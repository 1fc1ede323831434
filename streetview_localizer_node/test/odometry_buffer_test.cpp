// Odometry is kept within bounds whatever its stamps.
#include <gtest/gtest.h>

#include "../src/odometry_buffer.h"

namespace streetview_localizer {
namespace {

TimedPose at(double stamp) {
  TimedPose pose;
  pose.stamp = stamp;
  return pose;
}

TEST(OdometryBuffer, KeepsTenSecondsAndFindsTheNearest) {
  OdometryBuffer buffer;
  for (int i = 0; i <= 3000; ++i) buffer.push(at(100 + 0.01 * i));
  EXPECT_LE(buffer.size(), 1002u);
  EXPECT_TRUE(buffer.reaches(130));
  EXPECT_FALSE(buffer.reaches(130.5));
  ASSERT_TRUE(buffer.nearest(125.004, 0.1));
  EXPECT_NEAR(buffer.nearest(125.004, 0.1)->stamp, 125, 1e-6);
  EXPECT_FALSE(buffer.nearest(131, 0.5));
}

TEST(OdometryBuffer, DoesNotGrowAfterAStampFarAhead) {
  OdometryBuffer buffer;
  buffer.push(at(100));
  buffer.push(at(4e9));
  for (int i = 0; i < 3000; ++i) buffer.push(at(100 + 0.01 * i));
  EXPECT_LE(buffer.size(), 1002u);
  for (int i = 0; i < 30000; ++i) buffer.push(at(140));
  EXPECT_LE(buffer.size(), OdometryBuffer::kMost);
  buffer.push(at(5));  // a looped bag
  EXPECT_EQ(buffer.size(), 1u);
}

}  // namespace
}  // namespace streetview_localizer
