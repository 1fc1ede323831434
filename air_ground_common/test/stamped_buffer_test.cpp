#include "air_ground_common/stamped_buffer.h"

#include <gtest/gtest.h>

namespace air_ground_common {
namespace {

TEST(StampedBuffer, FindsTheNearestWithinTheTolerance) {
  StampedBuffer<int> buffer(30);
  EXPECT_EQ(buffer.nearest(0, 1e9), nullptr);
  for (const int i : {10, 11, 13}) EXPECT_TRUE(buffer.add(i, i));
  EXPECT_EQ(*buffer.nearest(11.4, 1), 11);
  EXPECT_EQ(*buffer.nearest(12.1, 1), 13);
  EXPECT_EQ(*buffer.nearest(9.5, 1), 10);
  EXPECT_EQ(*buffer.nearest(13.5, 1), 13);
  EXPECT_EQ(buffer.nearest(12, 0.5), nullptr);
  EXPECT_EQ(buffer.newest(), 13);
  buffer.clear();
  EXPECT_TRUE(buffer.empty());
  EXPECT_LT(buffer.newest(), 0);
}

TEST(StampedBuffer, KeepsASpanOfTimeInOrder) {
  StampedBuffer<int> buffer(2.0);
  for (int i = 0; i < 100; ++i) buffer.add(0.1 * i, i);
  EXPECT_LE(buffer.size(), 22u);
  EXPECT_EQ(buffer.nearest(5, 0.5), nullptr);
  EXPECT_FALSE(buffer.add(9.0, 7)) << "older than the newest";
  EXPECT_FALSE(buffer.add(std::nan(""), 7));
}

// A driver whose clock stands still, or creeps, must not fill the memory.
TEST(StampedBuffer, AFrozenStampDoesNotGrowIt) {
  StampedBuffer<int> buffer(30, 1000);
  for (int i = 0; i < 5000; ++i) buffer.add(1.5e9, i);
  EXPECT_EQ(buffer.size(), 1u);
  for (int i = 0; i < 5000; ++i) buffer.add(1.5e9 + 1e-5 * i, i);
  EXPECT_EQ(buffer.size(), 1000u);
}

TEST(StampedBuffer, AStampFarAheadDoesNotShutItForGood) {
  StampedBuffer<int> buffer(10);
  buffer.add(100, 1);
  buffer.add(4e9, 2);
  for (int i = 0; i < 3000; ++i) EXPECT_TRUE(buffer.add(100 + 0.01 * i, i)) << i;
  EXPECT_LE(buffer.size(), 1002u);
  EXPECT_EQ(*buffer.nearest(125.004, 0.1), 2500);
  EXPECT_TRUE(buffer.add(5, 7)) << "a looped bag";
  EXPECT_EQ(buffer.size(), 1u);
}

// Differences of ros::Time throw from 2038 on where they exceed 2^31 s; seconds in double do not.
TEST(StampedBuffer, BearsAnyStamp) {
  StampedBuffer<int> buffer(30);
  EXPECT_TRUE(buffer.add(0, 1));
  EXPECT_TRUE(buffer.add(4294967295.0, 2));
  EXPECT_EQ(buffer.size(), 1u);
  EXPECT_EQ(*buffer.nearest(4294967295.0, 1e-3), 2);
}

}  // namespace
}  // namespace air_ground_common
