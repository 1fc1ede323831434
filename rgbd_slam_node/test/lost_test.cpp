// What a robot that was lost goes by to be found again.
#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::drive;
using simulated::Robot;

struct Step {
  double stamp, seen_at;  ///< the image is that of the time `seen_at` [s]
  bool black = false, without_depth = false;
  double noise = 0;  ///< of black images, standard deviation [grey levels]
};

SlamResult take(const Robot& robot, Slam& slam, const Step& step) {
  simulated::synthetic::Random random(17);
  auto frame = robot.frame(step.seen_at, random);
  if (step.black) frame.gray.setTo(15);
  if (step.noise > 0) {
    static cv::RNG grain(3);
    cv::Mat noise(frame.gray.size(), CV_8S);
    grain.fill(noise, cv::RNG::NORMAL, 0, step.noise);
    cv::add(frame.gray, noise, frame.gray, cv::noArray(), CV_8U);
  }
  if (step.without_depth) frame.depth.setTo(std::numeric_limits<float>::quiet_NaN());
  return slam.process(step.stamp, frame.gray, cv::Mat(), frame.depth, robot.told_delay);
}

// The light goes out, the gain rises, and the depth camera, which has a light of its own, goes on.
TEST(Lost, NoiseInTheDarkIsNoOtherPlaceAndBeginsNoMap) {
  Robot robot;
  Slam slam(robot.camera, robot.mounting, {});
  for (double stamp = 0.1; stamp < 1; stamp += 0.1) {
    const SlamResult dark = take(robot, slam, {stamp, stamp, true, false, 8});
    EXPECT_EQ(dark.state, State::kInitializing);
    EXPECT_NE(dark.reason.find("nothing but noise"), std::string::npos) << dark.reason;
  }
  drive(robot, slam, 1, 6, false);
  ASSERT_EQ(slam.counters().maps, 1);
  double stamp = 6.1;
  for (; stamp < 14; stamp += 0.1) take(robot, slam, {stamp, stamp, true, false, 8});
  SlamResult last;
  for (; stamp < 20 && last.state != State::kTracking; stamp += 0.1) last = take(robot, slam, {stamp, 5.5});
  EXPECT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_EQ(slam.counters().maps, 1);
}

// A long map keeps few images; the robot is carried back to where it began.
TEST(Lost, APlaceWhoseImagesAreGoneIsEnteredByItsFeatures) {
  Robot robot;
  SlamSettings settings;
  settings.local_keyframes = settings.max_image_keyframes = 4;
  Slam slam(robot.camera, robot.mounting, settings);
  drive(robot, slam, 0, 6, false);
  ASSERT_EQ(slam.counters().maps, 1);
  ASSERT_TRUE(slam.map().keyframes().begin()->second.pyramid.empty());
  double stamp = 6.1;
  for (; stamp < 8; stamp += 0.1) take(robot, slam, {stamp, stamp, true, true});
  SlamResult last;
  for (; stamp < 14; stamp += 0.1) {
    last = take(robot, slam, {stamp, 0.5});
    if (last.state == State::kTracking) break;
  }
  ASSERT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_TRUE(last.relocalized);
  EXPECT_EQ(slam.counters().maps, 1);
  EXPECT_LT((last.T_map_base.translation() - robot.mapped(0.5).translation()).norm(), 0.05);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(take(robot, slam, {stamp += 0.1, 0.5}).state, State::kTracking);
}

TEST(Lost, OneBadDepthImageInTheDarkIsForgiven) {
  Robot robot;
  robot.walls = true;
  robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                                          air_ground_common::opticalFromForwardBody().transpose();
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 4.05, true, [](double t) { return t > 3; });
  ASSERT_EQ(slam.counters().lost_frames, 0);
  EXPECT_EQ(take(robot, slam, {4.1, 4.1, true, true}).state, State::kLost);
  SlamResult last;
  for (double stamp = 4.2; stamp < 5; stamp += 0.1) last = take(robot, slam, {stamp, stamp, true});
  EXPECT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_TRUE(last.by_depth);
  EXPECT_LE(slam.counters().lost_frames, 2);
  EXPECT_LT((last.T_map_base.translation() - robot.mapped(4.9).translation()).norm(), 0.03);
}

// A robot that stands has one keyframe, and many poses.
TEST(Lost, AHandBeforeTheLensOfAStandingRobotEndsNoMap) {
  Robot robot;
  robot.rest = 1e3;
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 6);
  ASSERT_EQ(slam.map().keyframeCount(), 1u);
  double stamp = 6.1;
  EXPECT_EQ(take(robot, slam, {stamp, stamp, true, true}).state, State::kLost);
  SlamResult last;
  for (int i = 0; i < 4; ++i) {
    stamp += 0.1;
    last = take(robot, slam, {stamp, stamp});
  }
  EXPECT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_EQ(slam.counters().maps, 1);
}

/// The IMU is the robot's, the images are of another place: as if somebody stood before the lens.
SlamResult seeStrange(const Robot& robot, Slam& slam, double from, double to) {
  Robot elsewhere = robot;
  elsewhere.texture = simulated::synthetic::texture(1800, 8);
  elsewhere.texture.convertTo(elsewhere.texture, -1, 1.8, -102);
  simulated::synthetic::Random random(23);
  auto frame = elsewhere.frame(0, random);
  frame.depth.setTo(0.8F);
  SlamResult last;
  double next_imu = from - 0.1 + 0.01;
  for (double stamp = from; stamp < to; stamp += 0.1) {
    for (; next_imu <= stamp + 0.005; next_imu += robot.imu_step) slam.addImu(robot.imu(next_imu, random));
    last = slam.process(stamp, frame.gray, cv::Mat(), frame.depth);
  }
  return last;
}

TEST(Lost, SomebodyBeforeARobotThatStandsEndsNoMap) {
  Robot robot;
  robot.rest = 1e3;
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 4);
  EXPECT_EQ(seeStrange(robot, slam, 4.1, 12.1).state, State::kLost);
  SlamResult last;
  for (double stamp = 12.1; stamp < 12.6; stamp += 0.1) last = take(robot, slam, {stamp, 2});
  EXPECT_EQ(last.state, State::kTracking) << last.reason;
  EXPECT_EQ(slam.mapId(), 1);
}

TEST(Lost, ARobotThatMovesAmongStrangePlacesBeginsANewMap) {
  Robot sets_off, drives_evenly;
  sets_off.rest = 6;
  drives_evenly.radius = 1e3;  // without a turn or a force that an IMU would feel
  for (const double lost_at : {2.4, 2.5, 2.6, 4.0}) {
    for (const Robot& robot : {sets_off, drives_evenly}) {
      Slam slam(robot.camera, robot.mounting, {});
      drive(robot, slam, 0, lost_at);
      EXPECT_EQ(slam.mapId(), 1);
      seeStrange(robot, slam, lost_at + 0.1, lost_at + 10.1);
      EXPECT_EQ(slam.mapId(), 2) << robot.radius << ", " << lost_at;
    }
  }
}

// Where it was lost it knew less of its place than where it began, and is found.
TEST(Lost, FoundAgainItsCovarianceIsThatOfThePlace) {
  Robot robot;
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 9);
  double stamp = 9.1;
  for (; stamp < 10; stamp += 0.1) take(robot, slam, {stamp, stamp, true, true});
  SlamResult found;
  for (; stamp < 14 && !found.relocalized; stamp += 0.1) found = take(robot, slam, {stamp, 0.5});
  ASSERT_TRUE(found.relocalized) << found.reason;
  const SlamResult next = take(robot, slam, {stamp, 0.5});
  ASSERT_EQ(next.state, State::kTracking);
  const auto sum = [](const Matrix6d& m, int first) { return m.diagonal().segment<3>(first).sum(); };
  EXPECT_LT(sum(found.covariance, 0), 2 * sum(next.covariance, 0));
  EXPECT_LT(sum(found.covariance, 3), 2 * sum(next.covariance, 3));
}

}  // namespace
}  // namespace rgbd_slam
