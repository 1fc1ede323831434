// Which keyframes an adjustment moves, and which image has its result: the same whether its thread is quick or slow.
#include "../src/map_adjuster.h"

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "synthetic_flight.h"
#include "synthetic_map.h"

namespace mav_vo {
namespace {

using visual_frontend::BundleSettings;
using visual_frontend::InertialMap;
using visual_frontend::Keyframe;
using visual_frontend::KeyframeId;
using visual_frontend::LandmarkId;
using visual_frontend::Map;

/// Keyframes in a row, 0.2 m apart, 3 m above a floor that each of them sees as it is.
Map rowOver(int keyframes) {
  Map map;
  const CameraModel camera = synthetic::camera();
  std::vector<LandmarkId> floor;
  for (int x = -10; x <= 10 + keyframes; ++x)
    for (int y = -6; y <= 6; ++y)
      floor.push_back(map.addLandmark({0.2 * x, 0.2 * y, 3 + 0.05 * ((x * 7 + y * 3) % 5)}));
  for (int i = 0; i < keyframes; ++i) {
    Pose T = Pose::Identity();
    T.translation().x() = 0.2 * i;
    Keyframe keyframe = visual_frontend::synthetic::keyframeAt(T, map, floor, camera);
    keyframe.stamp = i;
    map.addKeyframe(std::move(keyframe));
  }
  return map;
}

std::vector<KeyframeId> camerasOf(const BundleJob& job, bool fixed) {
  std::vector<KeyframeId> ids;
  for (std::size_t i = 0; i < job.keyframes.size(); ++i)
    if (job.problem.cameras[i].fixed == fixed) ids.push_back(job.keyframes[i]);
  return ids;
}

OdometrySettings windowOf(int window, int window_fixed, bool synchronous) {
  OdometrySettings settings;
  settings.window = window;
  settings.window_fixed = window_fixed;
  settings.synchronous = synchronous;
  return settings;
}

TEST(MapAdjuster, TheNewestMoveAndOlderObserversHoldThem) {
  Map map = rowOver(12);
  map.addKeyframe(Keyframe{});  // far from all of them: it sees nothing
  const InertialMap inertial;
  MapAdjuster adjuster(synthetic::camera(), windowOf(4, 3, true));
  const auto jobs = adjuster.adjustNewest(map, inertial, {}, 0);
  ASSERT_EQ(jobs.size(), 1u);
  EXPECT_FALSE(jobs[0].full);
  EXPECT_EQ(camerasOf(jobs[0], false), (std::vector<KeyframeId>{9, 10, 11, 12}));
  const auto held = camerasOf(jobs[0], true);
  EXPECT_EQ(held.size(), 4u) << "where the inertial chain begins, and window_fixed more";
  EXPECT_EQ(held.front(), 8);
  for (const KeyframeId id : held) EXPECT_LT(id, 9);
}

// Close to the floor, or turning, ten keyframes are two seconds: too short for the accelerometer to hold the scale.
TEST(MapAdjuster, WhereTheImuHoldsTheScaleTheWindowLastsLonger) {
  const Map map = rowOver(12);  // one a second
  const auto moving = [&map](bool metric, double duration) {
    OdometrySettings settings = windowOf(3, 3, true);
    settings.window_duration = duration;
    InertialMap inertial;
    inertial.metric = metric;
    return camerasOf(MapAdjuster(synthetic::camera(), settings).adjustNewest(map, inertial, {}, 0).at(0), false).size();
  };
  EXPECT_EQ(moving(false, 4.5), 3u);
  EXPECT_EQ(moving(true, 1.5), 3u);
  EXPECT_EQ(moving(true, 4.5), 5u) << "those from 4.5 s ago";
  EXPECT_EQ(moving(true, 100), 6u) << "twice as many, at most";
}

TEST(MapAdjuster, MovesAKeyframeToWhereItsLandmarksSayItIs) {
  Map map = rowOver(6);
  map.keyframe(5).T_map_camera.translation() += Eigen::Vector3d(0.05, -0.03, 0.02);
  MapAdjuster adjuster(synthetic::camera(), windowOf(1, 4, true));
  InertialMap inertial;
  for (const BundleJob& job : adjuster.adjustNewest(map, inertial, {}, 0)) applyBundle(job, map, &inertial);
  EXPECT_LT((map.keyframe(5).T_map_camera.translation() - Eigen::Vector3d(1, 0, 0)).norm(), 1e-4);
}

// Two keyframes one image apart: the second is adjusted to what the adjustment of the first makes of the map.
TEST(MapAdjuster, AKeyframeIsHeldByTheMapAsTheOneBeforeCorrectedIt) {
  const Map seven = rowOver(7);
  Map map = seven;
  map.removeKeyframe(6);
  map.keyframe(5).T_map_camera.translation() += Eigen::Vector3d(0.05, -0.03, 0.02);
  MapAdjuster adjuster(synthetic::camera(), windowOf(1, 4, false));
  InertialMap inertial;
  EXPECT_TRUE(adjuster.adjustNewest(map, inertial, {}, 10).empty());
  EXPECT_THROW(adjuster.adjustNewest(map, inertial, {}, 10.05), std::logic_error);
  for (const BundleJob& job : adjuster.finishNewest()) applyBundle(job, map, &inertial);
  Keyframe last = seven.keyframe(6);
  last.T_map_camera.translation() += Eigen::Vector3d(0.01, 0.01, 0);
  const KeyframeId id = map.addKeyframe(std::move(last));
  EXPECT_TRUE(adjuster.adjustNewest(map, inertial, {}, 10.05).empty());
  for (const BundleJob& job : adjuster.finishNewest()) applyBundle(job, map, &inertial);
  EXPECT_LT((map.keyframe(id).T_map_camera.translation() - Eigen::Vector3d(1.2, 0, 0)).norm(), 1e-4);
}

/// All that a map has of an IMU which turns with `rate` [rad/s] as its gyro reads it, begun with no bias.
InertialMap turningBy(const Eigen::Vector3d& rate, const Map& map) {
  InertialMap inertial;
  for (const auto& [id, keyframe] : map.keyframes()) {
    inertial.states[id] = {};
    if (id == 0) continue;
    Preintegration motion(ImuNoise{}, ImuBias{});
    for (int i = 0; i < 50; ++i) {
      const double t = keyframe.stamp - 1 + 0.02 * i;
      const Eigen::Vector3d up(0, 0, kGravity);
      motion.integrate({t, rate, up}, {t + 0.02, rate, up});
    }
    inertial.links.emplace(id, motion);
  }
  return inertial;
}

// The first keyframes were adjusted while the bias was hardly known; where they have left the window they must not hold
// it.
TEST(MapAdjuster, OldKeyframesHoldNoGyroBiasOfAMapThatIsNotMetric) {
  Map map = rowOver(8);
  const Eigen::Vector3d bias(0.01, 0.05, -0.02);
  InertialMap inertial = turningBy(bias, map);
  MapAdjuster adjuster(synthetic::camera(), windowOf(4, 3, true));
  for (const BundleJob& job : adjuster.adjustNewest(map, inertial, {}, 0)) applyBundle(job, map, &inertial);
  EXPECT_LT((inertial.states.at(7).bias.gyro - bias).norm(), 2e-3);
}

TEST(MapAdjuster, OfALongFlightTheOldestStay) {
  Map map = rowOver(8);
  OdometrySettings settings = windowOf(4, 3, true);
  settings.full_max_keyframes = 5;
  MapAdjuster adjuster(synthetic::camera(), settings);
  const auto jobs = adjuster.adjustWhole(adjuster.wholeMap(map, {}, {}), 0);
  ASSERT_EQ(jobs.size(), 1u);
  EXPECT_TRUE(jobs[0].full);
  EXPECT_EQ(camerasOf(jobs[0], true), (std::vector<KeyframeId>{0, 1, 2}));
}

void expectDueAfter(const MapAdjuster& adjuster, double stamp, double interval) {
  EXPECT_FALSE(adjuster.wholeDue(stamp + interval - 0.01)) << interval;
  EXPECT_TRUE(adjuster.wholeDue(stamp + interval)) << interval;
}

TEST(MapAdjuster, AWholeMapIsDueAsOftenAsItsSizeAllows) {
  OdometrySettings settings;
  settings.full_interval = 3;
  settings.full_max_keyframes = 60;
  MapAdjuster adjuster(synthetic::camera(), settings);
  for (const auto& [keyframes, interval] : {std::pair{2, 3.0}, {50, 8.0}, {60, 9.6}, {1000, 9.6}}) {
    adjuster.schedule(100, static_cast<std::size_t>(keyframes));
    expectDueAfter(adjuster, 100, interval);
  }
  adjuster.adjustWhole(adjuster.wholeMap(rowOver(3), {}, {}), 200);
  expectDueAfter(adjuster, 200, 3);
  adjuster.adjustWhole(adjuster.wholeMap(rowOver(25), {}, {}), 300);
  expectDueAfter(adjuster, 300, 4);

  settings.use_imu = false;
  MapAdjuster without_imu(synthetic::camera(), settings);
  without_imu.schedule(100, 2);
  expectDueAfter(without_imu, 100, 6);
}

/// Beside the tracking: `slow` has much to solve, of another none; a quick thread is given time to finish.
struct BesideTracking : ::testing::TestWithParam<bool> {
  BesideTracking() : map(rowOver(GetParam() ? 60 : 3)) {
    settings = windowOf(GetParam() ? 50 : 2, 10, false);
    settings.local_iterations = settings.full_iterations = GetParam() ? 40 : 1;
    for (const auto& entry : map.keyframes())
      map.keyframe(entry.first).T_map_camera.translation().y() += 0.01 * (entry.first % 3);
  }
  void pause() const {
    if (!GetParam()) std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }

  Map map;
  OdometrySettings settings;
};

TEST_P(BesideTracking, TheSecondImageHasTheResult) {
  MapAdjuster adjuster(synthetic::camera(), settings);
  EXPECT_TRUE(adjuster.adjustNewest(map, {}, {}, 10).empty());
  pause();
  EXPECT_TRUE(adjuster.due(10.05).empty());
  pause();
  const auto jobs = adjuster.due(10.1);
  ASSERT_EQ(jobs.size(), 1u);
  EXPECT_TRUE(jobs[0].result.usable);
  EXPECT_TRUE(adjuster.due(10.15).empty());
  EXPECT_TRUE(adjuster.finish().empty());
}

TEST_P(BesideTracking, TheNextOneOfItsKindWaitsForTheOneBefore) {
  MapAdjuster adjuster(synthetic::camera(), settings);
  EXPECT_TRUE(adjuster.adjustNewest(map, {}, {}, 10).empty());
  const auto jobs = adjuster.finishNewest();
  ASSERT_EQ(jobs.size(), 1u);
  EXPECT_TRUE(jobs[0].result.usable);
  EXPECT_TRUE(adjuster.finishNewest().empty());
  EXPECT_TRUE(adjuster.adjustNewest(map, {}, {}, 10.05).empty());
  EXPECT_EQ(adjuster.finish().size(), 1u);
}

TEST_P(BesideTracking, OfTheWholeMapThereIsOneAtATimeAskedForOnceASecond) {
  MapAdjuster adjuster(synthetic::camera(), settings);
  adjuster.schedule(0, 1);
  EXPECT_TRUE(adjuster.adjustWhole(adjuster.wholeMap(map, {}, {}), 10).empty());
  EXPECT_FALSE(adjuster.wholeDue(10.5));
  EXPECT_TRUE(adjuster.adjustWhole(adjuster.wholeMap(map, {}, {}), 10.5).empty());
  EXPECT_TRUE(adjuster.wholeDue(10.5)) << "it could not begin, and is due as soon as it can";
  pause();
  EXPECT_TRUE(adjuster.due(10.99).empty());
  if (GetParam()) return adjuster.discard();
  // A local one, begun before the whole map moves, comes before it.
  EXPECT_TRUE(adjuster.adjustNewest(map, {}, {}, 11).empty());
  const auto jobs = adjuster.due(11.05);
  ASSERT_EQ(jobs.size(), 2u);
  EXPECT_FALSE(jobs[0].full);
  EXPECT_TRUE(jobs[1].full);
}

// 1 s and 0.02 s a keyframe after it began, done or not.
TEST_P(BesideTracking, InAReplayTheWholeMapsImageIsKnown) {
  settings.reproducible = true;
  MapAdjuster adjuster(synthetic::camera(), settings);
  EXPECT_TRUE(adjuster.adjustWhole(adjuster.wholeMap(map, {}, {}), 10).empty());
  pause();
  const double due = 11 + 0.02 * static_cast<double>(map.keyframeCount());
  EXPECT_TRUE(adjuster.due(11.05).empty());
  EXPECT_TRUE(adjuster.due(due - 0.01).empty());
  const auto jobs = adjuster.due(due + 0.01);
  ASSERT_EQ(jobs.size(), 1u);
  EXPECT_TRUE(jobs[0].full);
}

TEST_P(BesideTracking, NothingComesOfWhatIsDiscarded) {
  MapAdjuster adjuster(synthetic::camera(), settings);
  adjuster.adjustNewest(map, {}, {}, 10);
  adjuster.adjustWhole(adjuster.wholeMap(map, {}, {}), 10);
  adjuster.discard();
  EXPECT_TRUE(adjuster.due(10.05).empty());
  EXPECT_TRUE(adjuster.due(12).empty());
  EXPECT_TRUE(adjuster.finish().empty());
}

INSTANTIATE_TEST_SUITE_P(Thread, BesideTracking, ::testing::Bool(),
                         [](const auto& info) { return info.param ? "Slow" : "Quick"; });

}  // namespace
}  // namespace mav_vo
