#include "air_ground_common/robot_map_session.h"

#include <gtest/gtest.h>

namespace air_ground_common {
namespace {

using Verdict = RobotMapSession::Verdict;

TEST(RobotMapSession, ANewIdEndsTheMapAndMakesEarlierStampsStale) {
  RobotMapSession map("mav_map");
  EXPECT_EQ(map.admit("mav_map", 5), Verdict::kCurrent);
  EXPECT_FALSE(map.observe(1, 6)) << "the first id that is known is the present map's";
  EXPECT_FALSE(map.observe(1, 7));
  EXPECT_EQ(map.admit("mav_map", 5.5), Verdict::kCurrent);
  EXPECT_TRUE(map.observe(2, 8));
  EXPECT_FALSE(map.observe(2, 9));
  EXPECT_EQ(map.admit("mav_map", 7.9), Verdict::kStale);
  EXPECT_TRUE(map.isStale(7.9));
  EXPECT_EQ(map.admit("mav_map", 8), Verdict::kCurrent);
}

TEST(RobotMapSession, ACorrectionMakesEarlierStampsStale) {
  RobotMapSession map("mav_map");
  map.observe(1, 1);
  EXPECT_FALSE(map.revise(5, 2)) << "the first count that is known is of the present map";
  EXPECT_FALSE(map.revise(5, 3));
  EXPECT_TRUE(map.revise(6, 4));
  EXPECT_EQ(map.admit("mav_map", 3.9), Verdict::kStale);
  EXPECT_EQ(map.admit("mav_map", 4), Verdict::kCurrent);
  map.observe(2, 5);
  EXPECT_FALSE(map.revise(0, 5)) << "another map counts anew";
  map.restart();
  EXPECT_FALSE(map.revise(3, 1));
}

TEST(RobotMapSession, AJumpOfTimeMakesNothingStale) {
  RobotMapSession map("mav_map");
  map.observe(1, 100);
  map.observe(2, 200);
  map.restart();
  EXPECT_FALSE(map.id());
  EXPECT_EQ(map.admit("mav_map", 3), Verdict::kCurrent);
  EXPECT_FALSE(map.observe(1, 4)) << "a looped bag names its first map again";
}

TEST(RobotMapSession, TheFrameTellsAMapWithoutScaleFromAMetricOne) {
  RobotMapSession map("mav_map", "mav_visual_map");
  EXPECT_FALSE(map.ownUnit());
  EXPECT_EQ(map.expectedFrame(), "mav_map");
  EXPECT_EQ(map.admit("odom", 1), Verdict::kOtherFrame);
  EXPECT_EQ(map.admit("", 1), Verdict::kOtherFrame);
  EXPECT_EQ(map.frame(), "");
  EXPECT_EQ(map.admit("mav_visual_map", 1), Verdict::kCurrent);
  EXPECT_TRUE(map.ownUnit());
  EXPECT_EQ(map.expectedFrame(), "mav_visual_map");
  EXPECT_EQ(map.admit("/mav_map", 2), Verdict::kNewMap);
  EXPECT_FALSE(map.ownUnit());
  EXPECT_EQ(map.frame(), "mav_map");
  EXPECT_EQ(map.admit("mav_map", 3), Verdict::kCurrent);
  map.observe(1, 3);
  map.observe(2, 10);
  EXPECT_EQ(map.admit("mav_visual_map", 9), Verdict::kStale);
  EXPECT_EQ(map.frame(), "mav_map") << "what is late does not bring the old map back";
}

TEST(RobotMapSession, ASlashBeforeAFrameIsNoOtherFrame) {
  RobotMapSession map("/mav_map", "/mav_visual_map");
  EXPECT_EQ(map.admit("/mav_map", 1), Verdict::kCurrent);
  EXPECT_EQ(map.admit("mav_map", 1), Verdict::kCurrent);
  EXPECT_EQ(map.admit("mav_visual_map", 2), Verdict::kNewMap);
}

TEST(RobotMapSession, WithoutAFrameGivenTheFirstOneCounts) {
  RobotMapSession map("");
  EXPECT_EQ(map.admit("", 1), Verdict::kOtherFrame);
  EXPECT_EQ(map.admit("map", 1), Verdict::kCurrent);
  EXPECT_EQ(map.admit("other", 2), Verdict::kOtherFrame);
  EXPECT_EQ(map.expectedFrame(), "map");
}

TEST(RobotMapSession, WhatTheRobotSaysItselfCounts) {
  RobotMapSession map("mav_map");
  EXPECT_FALSE(map.observe(3, 1, true));
  EXPECT_TRUE(map.observe(4, 2, true));
  EXPECT_TRUE(map.observe(5, 3));
  EXPECT_FALSE(map.observe(6, 4, true));
  EXPECT_EQ(map.id(), 5u);
  map.restart();
  EXPECT_FALSE(map.observe(6, 5, true));
  EXPECT_EQ(map.id(), 6u);
}

}  // namespace
}  // namespace air_ground_common
