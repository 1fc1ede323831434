// Time that runs back: by stamps alone, without a master.
#include <gtest/gtest.h>

#include <stdexcept>

#include "air_ground_common/ros/health.h"

namespace air_ground_common::ros_utils {
namespace {

TEST(TimeJumpDetector, SeesALoopedBagOnceAndForgivesDisorder) {
  TimeJumpDetector detector(1.0);
  EXPECT_FALSE(detector.jumped(ros::Time(100.0)));
  EXPECT_FALSE(detector.jumped(ros::Time(160.0)));
  EXPECT_FALSE(detector.jumped(ros::Time(159.5))) << "late, not a jump";
  EXPECT_TRUE(detector.jumped(ros::Time(100.0)));
  EXPECT_FALSE(detector.jumped(ros::Time(100.1)));
}

TEST(StreamJumpDetector, LaggingStreamIsNoJumpAndLoopedBagIsOne) {
  using Verdict = StreamJumpDetector::Verdict;
  StreamJumpDetector detector(2);
  const ros::WallTime wall(50.0);
  EXPECT_EQ(detector.watch(0, ros::Time(110.0), wall), Verdict::kInOrder);
  EXPECT_EQ(detector.watch(1, ros::Time(104.0), wall), Verdict::kInOrder) << "six seconds behind the other is a lag";
  EXPECT_EQ(detector.watch(0, ros::Time(130.0), wall), Verdict::kInOrder);
  EXPECT_EQ(detector.watch(0, ros::Time(100.0), wall), Verdict::kJump);
  EXPECT_EQ(detector.watch(1, ros::Time(129.0), wall), Verdict::kOld) << "the end of the first pass";
  EXPECT_EQ(detector.watch(0, ros::Time(100.1), wall), Verdict::kInOrder);
  EXPECT_EQ(detector.watch(1, ros::Time(100.2), wall), Verdict::kInOrder) << "follows: no second reset";
  EXPECT_EQ(detector.watch(1, ros::Time(120.0), wall), Verdict::kInOrder);
  EXPECT_EQ(detector.watch(1, ros::Time(100.0), wall), Verdict::kJump) << "the next loop";
  EXPECT_EQ(detector.watch(0, ros::Time(119.5), wall), Verdict::kOld);
  EXPECT_EQ(detector.watch(0, ros::Time(119.6), wall + ros::WallDuration(5.0)), Verdict::kInOrder)
      << "patience is over";
  EXPECT_THROW(detector.watch(2, ros::Time(1.0), wall), std::out_of_range);
}

TEST(StreamJumpDetector, AStreamThatBeginsAfterAShortJumpIsNotOld) {
  using Verdict = StreamJumpDetector::Verdict;
  StreamJumpDetector detector(2);
  const ros::WallTime wall(50.0);
  EXPECT_EQ(detector.watch(0, ros::Time(101.4), wall), Verdict::kInOrder);
  EXPECT_EQ(detector.watch(1, ros::Time(101.4), wall), Verdict::kInOrder);
  EXPECT_EQ(detector.watch(0, ros::Time(100.0), wall), Verdict::kJump);
  EXPECT_EQ(detector.watch(1, ros::Time(101.3), wall), Verdict::kOld);
  EXPECT_EQ(detector.watch(1, ros::Time(102.0), wall), Verdict::kInOrder) << "the old pass never came so far";
}

TEST(StreamJumpDetector, OneWrongStampIsNoJump) {
  using Verdict = StreamJumpDetector::Verdict;
  StreamJumpDetector detector(1);
  const ros::WallTime wall(50.0);
  const auto watch = [&](double t) { return detector.watch(0, ros::Time(t), wall); };
  double t = 100;
  for (int i = 0; i < 50; ++i, t += 0.01) ASSERT_EQ(watch(t), Verdict::kInOrder);
  for (const double wrong : {t + 3, t - 40, 4.2e9}) {
    EXPECT_EQ(watch(wrong), Verdict::kHeld) << wrong;
    EXPECT_EQ(watch(t += 0.01), Verdict::kInOrder) << "after " << wrong;
  }
  EXPECT_EQ(detector.watch(0, ros::Time(), wall), Verdict::kUnset) << "no stamp";
  EXPECT_EQ(detector.watch(0, ros::Time(0xFFFFFFFFu, 0), wall), Verdict::kUnset) << "an uninitialised stamp";
  EXPECT_EQ(watch(t += 0.01), Verdict::kInOrder);
  EXPECT_EQ(watch(t += 5), Verdict::kHeld) << "a gap costs one message";
  EXPECT_EQ(watch(t += 0.01), Verdict::kInOrder);
  EXPECT_EQ(watch(100), Verdict::kHeld);
  EXPECT_EQ(watch(100.01), Verdict::kJump) << "confirmed";
  EXPECT_EQ(watch(100.02), Verdict::kInOrder);
}

TEST(StreamJumpDetector, NoStreamBeginsWithAStampThatWasNotSet) {
  using Verdict = StreamJumpDetector::Verdict;
  StreamJumpDetector detector(1);
  ros::Time ones;
  ones.sec = ones.nsec = 0xFFFFFFFFu;
  for (const ros::Time& none : {ros::Time(), ros::Time(0xFFFFFFFFu, 0), ones})
    EXPECT_EQ(detector.watch(0, none), Verdict::kUnset) << none;
  EXPECT_EQ(detector.watch(0, 4294967299.3), Verdict::kUnset) << "more seconds than ros::Time holds";
  EXPECT_EQ(detector.watch(0, ros::Time(100.0)), Verdict::kInOrder) << "no jump";
}

TEST(TimeJumpDetector, BearsAnyStamp) {
  TimeJumpDetector detector;
  EXPECT_FALSE(detector.jumped(ros::Time(0xFFFFFFFFu, 0)));
  EXPECT_TRUE(detector.jumped(ros::Time(100.0)));
}

}  // namespace
}  // namespace air_ground_common::ros_utils
