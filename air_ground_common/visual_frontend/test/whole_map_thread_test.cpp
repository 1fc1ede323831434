// An adjustment beside the tracking: which image has its result, and that nobody waits for one that is of no use.
#include "visual_frontend/whole_map_thread.h"

#include <gtest/gtest.h>

#include <chrono>
#include <stdexcept>

#include "synthetic.h"
#include "synthetic_map.h"

namespace visual_frontend {
namespace {

using Clock = std::chrono::steady_clock;

double since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

/// Keyframes in a row above a floor. All but the first stand `off` [m] from where they saw it.
Map rowOver(int keyframes, int rows, double off) {
  Map map;
  std::vector<LandmarkId> floor;
  for (int x = -10; x <= 10 + keyframes; ++x)
    for (int y = -rows; y <= rows; ++y)
      floor.push_back(map.addLandmark({0.2 * x, 1.2 * y / rows, 3 + 0.05 * ((x * 7 + y * 3) % 5)}));
  for (int i = 0; i < keyframes; ++i) {
    Pose T = Pose::Identity();
    T.translation().x() = 0.2 * i;
    Keyframe keyframe = synthetic::keyframeAt(T, map, floor, synthetic::camera());
    keyframe.stamp = i;
    if (i > 0) keyframe.T_map_camera.translation() += off * Eigen::Vector3d(i % 2 ? 1 : -1, i % 3 - 1, 0.5);
    map.addKeyframe(std::move(keyframe));
  }
  return map;
}

BundleJob jobOf(const Map& map, int iterations) {
  BundleSettings settings;
  settings.max_iterations = iterations;
  settings.max_seconds = 600;
  settings.parameter_tolerance = 0;
  return extractWholeMap(map, synthetic::camera(), settings, {});
}

TEST(WholeMapThread, AReplayTakesTheResultOverAtAnImageThatTheSizeDecides) {
  const Map map = rowOver(5, 6, 0.01);
  WholeMapThread thread(true);
  EXPECT_FALSE(thread.due(100)) << "nothing runs";
  thread.start(jobOf(map, 3), 100);
  EXPECT_THROW(thread.start(jobOf(map, 3), 100), std::logic_error);
  EXPECT_FALSE(thread.due(100.9));
  EXPECT_FALSE(thread.due(101.09));
  EXPECT_TRUE(thread.due(101.11)) << "1 s and 0.02 s for each of five keyframes";
  EXPECT_TRUE(thread.await().result.usable);
  EXPECT_FALSE(thread.runs());
  EXPECT_FALSE(thread.due(200));
}

TEST(WholeMapThread, LiveItIsTakenOverOnceItIsThere) {
  const Map map = rowOver(5, 6, 0.01);
  WholeMapThread thread(false);
  thread.start(jobOf(map, 3), 100);
  EXPECT_FALSE(thread.due(100.9)) << "done or not";
  double stamp = 101;
  const auto begin = Clock::now();
  while (!thread.due(stamp) && since(begin) < 60) stamp += 1;
  EXPECT_TRUE(thread.await().result.usable);
}

TEST(WholeMapThread, WhatIsDiscardedEndsSoonAndIsOfNoUse) {
  const Map map = rowOver(40, 40, 0.3);
  BundleJob one = jobOf(map, 1);
  const auto begin = Clock::now();
  one.solve();
  const double iteration = since(begin);
  WholeMapThread thread(false);
  thread.start(jobOf(map, 100000), 100);
  thread.cancel();
  const BundleJob cancelled = thread.await();
  EXPECT_FALSE(cancelled.result.usable);
  EXPECT_LT(cancelled.result.iterations, 100);
  Map moved = map;
  applyBundle(cancelled, moved);
  EXPECT_EQ(moved.keyframe(7).T_map_camera.matrix(), map.keyframe(7).T_map_camera.matrix());
  thread.start(jobOf(map, 100000), 100);
  const auto discarded = Clock::now();
  thread.discard();
  EXPECT_LT(since(discarded), 20 * iteration + 5);
  EXPECT_FALSE(thread.runs());
}

}  // namespace
}  // namespace visual_frontend
