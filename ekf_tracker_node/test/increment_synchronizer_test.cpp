#include "ekf_tracker/increment_synchronizer.h"

#include <gtest/gtest.h>

#include <string>

namespace ekf_tracker {
namespace {

using Synchronizer = IncrementSynchronizer<std::string>;
using Admission = Synchronizer::Admission;

air_ground_common::Pose at(double x) { return air_ground_common::yawPose(0.1, {x, 0, 0}); }

class SynchronizerTest : public testing::Test {
 protected:
  Admission admit(double stamp, double now, bool metric = true) {
    return synchronizer_.admit({stamp - 0.1, stamp, metric, std::to_string(stamp)}, now);
  }

  TiltSource poses_;
  Synchronizer synchronizer_{0.5, poses_};
};

TEST_F(SynchronizerTest, AnIncrementWaitsForThePoseOfItsStamp) {
  admit(10.0, 0.0);
  EXPECT_FALSE(synchronizer_.next(0.1));
  poses_.addPose(10.0, at(3));
  const auto ready = synchronizer_.next(0.2);
  ASSERT_TRUE(ready && ready->T_map_base);
  EXPECT_EQ(ready->T_map_base->translation().x(), 3);
  EXPECT_FALSE(synchronizer_.next(0.2));
}

TEST_F(SynchronizerTest, ALaterPoseOrTheWaitEndsIt) {
  admit(10.0, 0.0);
  poses_.addPose(10.1, at(3));
  const auto passed = synchronizer_.next(0.0);
  ASSERT_TRUE(passed);
  EXPECT_FALSE(passed->T_map_base) << "the pose of that stamp was left out";
  admit(10.2, 1.0);
  EXPECT_FALSE(synchronizer_.next(1.4));
  EXPECT_TRUE(synchronizer_.next(1.6)) << "the wait is over";
}

TEST_F(SynchronizerTest, OdometryThatIsNotMetricIsWaitedForOnlyIfItGavePoses) {
  admit(10.0, 0.0, false);
  EXPECT_TRUE(synchronizer_.next(0.0));
  poses_.addPose(10.0, at(0));
  admit(10.1, 0.0, false);
  EXPECT_FALSE(synchronizer_.next(0.0)) << "it gave one at the increment's begin";
}

TEST_F(SynchronizerTest, WithoutAWaitNoPoseIsAskedFor) {
  Synchronizer synchronizer(0, poses_);
  synchronizer.admit({9.9, 10.0, true, "a"}, 0);
  EXPECT_TRUE(synchronizer.next(0));
}

TEST_F(SynchronizerTest, AStrayIsSetAsideAndARunIsAJump) {
  EXPECT_EQ(admit(100.0, 0), Admission::kTaken);
  EXPECT_EQ(admit(99.5, 0), Admission::kTaken) << "a little late is no stray";
  EXPECT_EQ(admit(20.0, 0), Admission::kSetAside);
  EXPECT_EQ(admit(100.1, 0), Admission::kTaken) << "which forgets the stray";
  EXPECT_EQ(admit(20.0, 0), Admission::kSetAside);
  EXPECT_EQ(admit(20.1, 0), Admission::kSetAside);
  EXPECT_EQ(admit(20.2, 0), Admission::kJump);
  poses_.addPose(30, at(0));
  for (const char* stamp : {"20.000000", "20.100000", "20.200000"}) {
    const auto ready = synchronizer_.next(0);
    ASSERT_TRUE(ready);
    EXPECT_EQ(ready->message, stamp) << "nothing of the new time is lost, all of the old is dropped";
  }
  EXPECT_FALSE(synchronizer_.next(0));
  EXPECT_EQ(admit(20.3, 0), Admission::kTaken);
}

TEST_F(SynchronizerTest, ARunOutOfOrderIsNoJump) {
  admit(100.0, 0);
  EXPECT_EQ(admit(20.0, 0), Admission::kSetAside);
  EXPECT_EQ(admit(19.0, 0), Admission::kSetAside);
  EXPECT_EQ(admit(18.0, 0), Admission::kSetAside);
}

TEST(TiltSource, TheAccelerometerStandsInWithoutFlightAccelerations) {
  TiltSource tilts;
  const double roll = 0.2;
  const Eigen::Vector3d up(0, 9.81 * std::sin(roll), 9.81 * std::cos(roll));
  for (int i = 0; i <= 300; ++i)
    tilts.addSpecificForce(0.01 * i, up + Eigen::Vector3d(3 * std::sin(40.0 * i), 0, 0));  // vibration
  const auto R = tilts.accelerometerTiltAt(3.0);
  ASSERT_TRUE(R);
  EXPECT_NEAR(std::acos((R->transpose() * Eigen::Vector3d::UnitZ()).dot(up.normalized())), 0, 0.02);
  EXPECT_FALSE(tilts.accelerometerTiltAt(3.5)) << "too old";
  EXPECT_FALSE(tilts.poseAt(3.0));
}

// Drivers that remove gravity, or count in g: what is left points anywhere, or is right by chance alone.
TEST(TiltSource, ForcesThatAreNotGravityTellNoTilt) {
  for (const double size : {0.3, 1.0, 3.0, 6.5, 13.5, 96.0}) {
    TiltSource tilts;
    for (int i = 0; i <= 500; ++i) {
      tilts.addSpecificForce(0.01 * i, size * Eigen::Vector3d(0.8, 0, 0.6));
      EXPECT_FALSE(tilts.accelerometerTiltAt(0.01 * i)) << size;
      EXPECT_EQ(tilts.lacksGravity(), i > 300) << size << " at " << 0.01 * i;
    }
    tilts.clear();
    EXPECT_FALSE(tilts.lacksGravity());
  }
  // A turn at 45 degrees for two seconds is no fault of the driver.
  TiltSource tilts;
  for (int i = 0; i <= 600; ++i) {
    tilts.addSpecificForce(0.01 * i, Eigen::Vector3d(0, 0, i < 200 || i > 400 ? 9.81 : 13.9));
    EXPECT_FALSE(tilts.lacksGravity());
  }
  EXPECT_TRUE(tilts.accelerometerTiltAt(6.0));
}

TEST(TiltSource, PosesOfAnEarlierTimeBeginAfresh) {
  TiltSource tilts;
  tilts.addPose(100, at(1));
  tilts.addPose(99.5, at(2));
  EXPECT_FALSE(tilts.poseAt(99.5)) << "not later, and no jump";
  tilts.addPose(50, at(3));
  EXPECT_TRUE(tilts.poseAt(50));
  EXPECT_EQ(tilts.newestPose(), 50);
}

}  // namespace
}  // namespace ekf_tracker
