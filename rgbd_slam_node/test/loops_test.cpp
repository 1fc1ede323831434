// A robot that drives in a circle with a camera that is not quite what it is told to be: what the closed loop makes of
// its map, at once or beside the tracking.
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <thread>

#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::Drive;
using simulated::drive;
using simulated::Robot;

SlamSettings settingsOf(bool closing) {
  SlamSettings settings;
  settings.loop_closure = closing;
  settings.reobserve_every = 0;  // so that nothing else closes the circle
  settings.loop_min_gap = 6;
  return settings;
}

struct Outcome {
  Drive run;
  air_ground_common::Trajectory trajectory;  ///< in the end
  int loops;
  double error() const {
    return (trajectory.back().T_map_body.translation() - run.truth.back().T_map_body.translation()).norm();
  }
  /// Frames with which the map was corrected as a whole [s].
  std::vector<double> corrected() const {
    std::vector<double> stamps;
    for (std::size_t i = 0; i < run.results.size(); ++i)
      if (run.results[i].map_corrected) stamps.push_back(run.stamps[i]);
    return stamps;
  }
};

/// Until that time, or until the first loop; `then` ends it.
Outcome aRound(
    const SlamSettings& settings, double until, bool to_first_loop = false,
    const std::function<void(Slam&)>& then = [](Slam& slam) { slam.finish(); }) {
  Robot robot;
  robot.mounting.R_base_imu.reset();
  robot.tilt.setZero();
  robot.speed = 0.35;
  robot.radius = 0.5;
  robot.rest = 0.2;
  CameraModel wrong = robot.camera;
  wrong.fx *= 1.03;  // makes it drift
  Slam slam(wrong, robot.mounting, settings);
  const double alone = to_first_loop ? 8 : until;
  Drive run = drive(robot, slam, 0, alone, false);
  for (int i = 1; to_first_loop && !run.results.back().map_corrected && i < 30; ++i) {
    Drive next = drive(robot, slam, alone + 0.1 * i, alone + 0.1 * i, false);
    run.results.push_back(next.results.front());
    run.stamps.push_back(next.stamps.front());
    run.truth.push_back(next.truth.front());
  }
  then(slam);
  return {std::move(run), slam.trajectory(), slam.counters().loops};
}

TEST(Loops, RemoveDrift) {
  const Outcome open = aRound(settingsOf(false), 10.4), closed = aRound(settingsOf(true), 10.4);
  EXPECT_EQ(closed.trajectory.size(), closed.run.stamps.size());
  EXPECT_GE(closed.loops, 1);
  EXPECT_GT(open.error(), 0.04);
  EXPECT_LT(closed.error(), 0.5 * open.error());
}

TEST(Loops, BesideTheTrackingTheMapIsAdjustedLaterAndAsWell) {
  constexpr double kUntil = 13.5;
  SlamSettings settings = settingsOf(true);
  const Outcome at_once = aRound(settings, kUntil);
  settings.synchronous = false;
  settings.reproducible = true;
  const Outcome beside = aRound(settings, kUntil), again = aRound(settings, kUntil);
  ASSERT_FALSE(at_once.corrected().empty());
  EXPECT_EQ(beside.corrected().front(), at_once.corrected().front()) << "the loop itself is closed as it is found";
  EXPECT_GT(beside.corrected().back(), beside.corrected().front() + 1) << "by what is adjusted beside the tracking";
  EXPECT_LT(beside.error(), at_once.error() + 0.005);
  for (const SlamResult& r : beside.run.results) {
    EXPECT_EQ(r.state, State::kTracking) << r.reason;
    EXPECT_LT(r.T_previous_current_base.translation().norm(), 0.06) << "increments are free of corrections";
  }
  for (std::size_t i = 0; i < beside.trajectory.size(); ++i)
    EXPECT_EQ(beside.trajectory[i].T_map_body.matrix(), again.trajectory[i].T_map_body.matrix())
        << "a replay gives the same each time";
}

TEST(Loops, WhatIsSavedHasTheAdjustmentThatStillRuns) {
  SlamSettings settings = settingsOf(true);
  const Outcome at_once = aRound(settings, 0, true);
  ASSERT_TRUE(at_once.run.results.back().map_corrected);
  settings.synchronous = false;
  const Outcome beside = aRound(settings, 0, true);
  ASSERT_EQ(beside.trajectory.size(), at_once.trajectory.size());
  for (std::size_t i = 0; i < beside.trajectory.size(); ++i)
    EXPECT_LT((beside.trajectory[i].T_map_body.translation() - at_once.trajectory[i].T_map_body.translation()).norm(),
              1e-3);
}

// Services are called between images, which wait meanwhile.
TEST(Loops, WhatIsSavedWhileImagesComeWaitsForNoAdjustment) {
  using Clock = std::chrono::steady_clock;
  SlamSettings settings = settingsOf(true);
  settings.synchronous = false;
  Clock::duration adjustment{};
  aRound(settings, 0, true, [&](Slam& slam) {
    ASSERT_TRUE(slam.adjusting());
    const auto begin = Clock::now();
    EXPECT_FALSE(slam.adoptFinished()) << "it has just begun";
    const Clock::duration waited = Clock::now() - begin;
    EXPECT_TRUE(slam.adjusting());
    EXPECT_TRUE(slam.finish());
    EXPECT_FALSE(slam.adjusting());
    adjustment = Clock::now() - begin;
    EXPECT_LT(10 * waited, adjustment);
  });
  aRound(settings, 0, true, [&](Slam& slam) {
    std::this_thread::sleep_for(4 * adjustment + std::chrono::seconds(1));
    EXPECT_TRUE(slam.adoptFinished()) << "what has finished is in the file";
    EXPECT_FALSE(slam.adjusting());
  });
}

}  // namespace
}  // namespace rgbd_slam
