// IMUs that do not serve: the map does without them, its covariance says so, and the reason names the cause.
#include <gtest/gtest.h>

#include "rgbd_slam/slam.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::Drive;
using simulated::drive;
using simulated::Robot;

/// Standard deviation of the better known one of roll and pitch, as a frame states it [rad].
double statedTilt(const SlamResult& r) { return std::sqrt(std::min(r.covariance(3, 3), r.covariance(4, 4))); }

/// By how much the base leans in the map, which is level where the base is [rad].
double lean(const SlamResult& r) { return std::acos(std::clamp(r.T_map_base.linear()(2, 2), -1.0, 1.0)); }

TEST(ImuFaults, AnAccelerometerOfTheOtherSignTurnsNoMapOver) {
  Robot robot;
  robot.accel_matrix = -Eigen::Matrix3d::Identity();
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 0, 5);
  for (const SlamResult& r : run.results) {
    if (r.state != State::kTracking) continue;
    EXPECT_NE(r.imu_problem.find("up points down in the base"), std::string::npos) << r.imu_problem;
    EXPECT_LT(lean(r), 0.1);
    EXPECT_GT(statedTilt(r), 0.015);
  }
  // The floor levels the map, in which the base leans as it stands.
  EXPECT_NEAR(lean(run.results.back()), robot.tilt.norm(), 0.015);
  EXPECT_EQ(run.results.back().state, State::kTracking);
  EXPECT_FALSE(slam.gravityKnown());
  EXPECT_EQ(slam.counters().lost_frames, 0);
}

// What is up came by a mounting that the turns contradict: it is not known any more, now or in the next map.
TEST(ImuFaults, AWrongMountingTellsNoUp) {
  Robot robot;
  robot.sway = 0.08;
  robot.sway_rate = 2;
  robot.gyro_matrix = robot.accel_matrix = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitX()).toRotationMatrix();
  Slam slam(robot.camera, robot.mounting, {});
  EXPECT_TRUE(drive(robot, slam, 0, 1).results.back().imu_problem.empty());
  EXPECT_TRUE(slam.gravityKnown());
  const SlamResult last = drive(robot, slam, 1.1, 14).results.back();
  ASSERT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_NE(last.imu_problem.find("gyro and images turn differently"), std::string::npos) << last.imu_problem;
  EXPECT_FALSE(slam.gravityKnown());
  EXPECT_GT(statedTilt(last), 1.4) << "the base stood on its side in this map, by an IMU that is not believed";

  Robot elsewhere = robot;
  elsewhere.texture = simulated::synthetic::texture(1800, 8);
  elsewhere.texture.convertTo(elsewhere.texture, -1, 1.8, -102);
  const SlamResult anew = drive(elsewhere, slam, 14.1, 21).results.back();
  ASSERT_EQ(anew.state, State::kTracking) << anew.reason;
  EXPECT_EQ(slam.mapId(), 2);
  EXPECT_FALSE(slam.gravityKnown());
  EXPECT_LT(lean(anew), 0.3);
}

// A camera in a hand, no IMU: the base leans by 22 degrees, and the floor shows it.
TEST(ImuFaults, WithoutOneTheFloorLevelsTheMap) {
  Robot robot;
  robot.tilt = {0.33, -0.2, 0};
  robot.mounting.R_base_imu.reset();
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 0, 4, false);
  const SlamResult& last = run.results.back();
  ASSERT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_FALSE(slam.gravityKnown());
  EXPECT_TRUE(slam.levelBySurfaces());
  EXPECT_EQ(slam.counters().maps, 1);
  EXPECT_LT(air_ground_common::rotationAngle(last.T_map_base.linear(), robot.mapped(run.stamps.back()).linear()), 0.02);
  EXPECT_LT(statedTilt(last), 0.03);
}

TEST(ImuFaults, SamplesTooFarApartAreNamed) {
  Robot robot;
  robot.imu_step = 0.1;
  Slam slam(robot.camera, robot.mounting, {});
  const SlamResult last = drive(robot, slam, 0, 5).results.back();
  EXPECT_EQ(last.state, State::kTracking);
  EXPECT_EQ(last.imu_problem.find("IMU at 10 Hz: steadily more than 20 Hz are needed"), 0u) << last.imu_problem;
  EXPECT_GT(statedTilt(last), 0.015) << "by the floor alone";
  EXPECT_EQ(drive(Robot(), slam, 5.1, 12).results.back().imu_problem, "") << "a driver that is put right";
}

}  // namespace
}  // namespace rgbd_slam
