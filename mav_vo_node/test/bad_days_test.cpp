// The whole odometry where the camera is lost, or the machine busy.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <map>
#include <optional>
#include <string>
#include <thread>

#include "rendered_flight.h"

using namespace mav_vo;

namespace {

TEST(Odometry, RecoversAfterBlackImagesInTheSameMap) {
  Options options;
  options.end = 11;
  options.black = [](double t) { return t > 9 && t < 9.6; };
  const Outcome o = fly(options);
  bool lost = false;
  for (const VoResult& r : o.frames) lost = lost || r.state == OdometryState::kLost;
  EXPECT_TRUE(lost);
  EXPECT_EQ(o.frames.back().state, OdometryState::kTracking);
  EXPECT_EQ(o.frames.back().map_id, o.frames.front().map_id);
  EXPECT_LT(ate(o, o.final_poses), 0.05);
}

// 2.5 m/s, 1.8 m above the ground, nothing seen for half a metre.
TEST(Odometry, CoastsThroughAShortLossInFastFlight) {
  Options options;
  options.flight.period = 3;
  options.end = 10;
  options.black = [](double t) { return t > 9 && t < 9.2; };
  const Outcome o = fly(options);
  ASSERT_GT(o.metric_at, 0);
  ASSERT_LT(o.metric_at, 8.5);
  int blind = 0, lost = 0;
  for (std::size_t i = 0; i < o.frames.size(); ++i)
    if (o.truth[i].stamp > 9 && o.frames[i].state == OdometryState::kLost) ++(o.truth[i].stamp < 9.19 ? blind : lost);
  EXPECT_GE(blind, 3);
  EXPECT_LE(lost, 1);
  EXPECT_LT(ate(o, o.final_poses), 0.05);
}

// The map begins while the IMU is silent, and no axis of base_link points up: nothing tells how it lies, until later.
TEST(Odometry, LevelsAMapThatBeganWithoutTheImu) {
  Options options;
  options.flight.wobble = 0.15;
  options.end = 14;
  options.silent_imu = [](double t) { return t < 2.5; };
  options.R_base_body = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const Outcome o = fly(options);
  ASSERT_TRUE(
      std::any_of(o.frames.begin(), o.frames.end(), [](const VoResult& r) { return r.stamp < 2.5 && r.pose_valid; }));
  EXPECT_EQ(o.frames.back().map_id, o.frames.front().map_id);
  ASSERT_GT(o.metric_at, 0) << o.frames.back().reason;
  double scale_error = 1;
  EXPECT_LT(ate(o, o.final_poses, &scale_error), 0.02 * air_ground_common::pathLength(o.truth));
  EXPECT_LT(std::abs(scale_error), 0.02);
}

// It waits for its scale: little is lost with it.
TEST(Odometry, StartsANewMapAfterLongDarknessAtItsStart) {
  Options options;
  options.end = 9;
  options.black = [](double t) { return t > 4 && t < 6; };
  OdometrySettings settings;
  settings.lost_timeout = 1.0;
  const Outcome o = fly(options, settings);
  EXPECT_GT(o.frames.back().map_id, o.frames.front().map_id);
  EXPECT_GE(static_cast<int>(o.frames.back().state), static_cast<int>(OdometryState::kScaling));
  EXPECT_NE(o.frames.back().state, OdometryState::kLost);
}

// It lands, and its lens is in the grass: that is no other place. Noise of a high gain has corners.
TEST(Odometry, KeepsItsMapInTheDark) {
  for (const double noise : {0.0, 5.0, 8.0}) {
    SCOPED_TRACE(noise);
    Options options;
    options.end = 14;
    options.black = [](double t) { return t > 9 && t < 13; };
    options.black_noise = noise;
    OdometrySettings settings;
    settings.lost_timeout = 1.0;
    const Outcome o = fly(options, settings);
    ASSERT_GT(o.metric_at, 0);
    ASSERT_LT(o.metric_at, 8.5);
    EXPECT_EQ(o.frames.back().state, OdometryState::kTracking);
    EXPECT_EQ(o.frames.back().map_id, o.frames.front().map_id);
    EXPECT_LT(ate(o, o.final_poses), 0.05);
  }
}

TEST(Odometry, StartsANewMapElsewhere) {
  Options options;
  options.end = 12;
  options.elsewhere = [](double t) { return t > 9; };
  OdometrySettings settings;
  settings.lost_timeout = 1.0;
  const Outcome o = fly(options, settings);
  ASSERT_GT(o.metric_at, 0);
  ASSERT_LT(o.metric_at, 8.5);
  for (std::size_t i = 0; i < o.frames.size() && o.frames[i].stamp < 9.9; ++i)
    EXPECT_EQ(o.frames[i].map_id, o.frames.front().map_id);
  EXPECT_GT(o.frames.back().map_id, o.frames.front().map_id);
  EXPECT_GE(static_cast<int>(o.frames.back().state), static_cast<int>(OdometryState::kScaling));
  EXPECT_NE(o.frames.back().state, OdometryState::kLost);
}

// So dark there that no corner can be described; the tracks live on fainter ones.
TEST(Odometry, StartsANewMapInADimmerPlace) {
  Options options;
  options.end = 14;
  options.elsewhere = [](double t) { return t > 9; };
  options.contrast = [](double t) { return t > 9 ? 0.1 : 1; };
  OdometrySettings settings;
  settings.lost_timeout = 1.0;
  const Outcome o = fly(options, settings);
  ASSERT_GT(o.metric_at, 0);
  ASSERT_LT(o.metric_at, 8.5);
  EXPECT_GT(o.frames.back().map_id, o.frames.front().map_id);
  EXPECT_NE(o.frames.back().state, OdometryState::kLost);
}

// Four images a second, of the link that is left: it is lost as long as at twenty.
TEST(Odometry, StartsANewMapElsewhereHoweverSlowlyImagesCome) {
  Options options;
  options.end = 13;
  options.elsewhere = [](double t) { return t > 9; };
  options.drop_image = [](double t) { return t > 9 && t < 11.5 && std::lround(20 * t) % 5 != 0; };
  OdometrySettings settings;
  settings.lost_timeout = 1.0;
  const Outcome o = fly(options, settings);
  ASSERT_GT(o.metric_at, 0);
  ASSERT_LT(o.metric_at, 8.5);
  std::size_t i = 0;
  while (i < o.frames.size() && o.frames[i].map_id == o.frames.front().map_id) ++i;
  ASSERT_LT(i, o.frames.size());
  EXPECT_GT(o.frames[i].stamp, 9.9);
  EXPECT_LT(o.frames[i].stamp, 11.5);
}

/// Threads that want the whole machine while this lives.
class BusyMachine {
 public:
  explicit BusyMachine(unsigned threads) {
    for (unsigned i = 0; i < threads; ++i)
      threads_.emplace_back([this] {
        while (!stop_) ++work_;
      });
  }
  ~BusyMachine() {
    stop_ = true;
    for (auto& thread : threads_) thread.join();
  }

 private:
  std::atomic<bool> stop_{false};
  std::atomic<unsigned> work_{0};
  std::vector<std::thread> threads_;
};

// No image holds the scale of a metric map: it must not be what gives way to an IMU that contradicts them.
TEST(Odometry, AnImuThatGoesWrongInFlightIsLeftOutAndNamed) {
  constexpr double kFault = 9;
  const ImuSample zero;
  std::optional<ImuSample> held;
  const std::map<std::string, std::function<void(ImuSample&)>> faults{
      {"repeats its last sample",
       [&](ImuSample& s) {
         if (!held) held = s;
         s = {s.stamp, held->angular_velocity, held->specific_force};
       }},
      {"sends zeros",
       [&](ImuSample& s) {
         s = {s.stamp, zero.angular_velocity, zero.specific_force};
       }},
      {"its clock is set", [&](ImuSample& s) { s.stamp += 0.3; }}};
  for (const auto& [name, fault] : faults) {
    SCOPED_TRACE(name);
    Options options;
    options.end = 22;
    options.spoil_imu = [&, spoil = fault](ImuSample& s) {
      if (s.stamp > kFault) spoil(s);
    };
    const Outcome o = fly(options);
    ASSERT_GT(o.metric_at, 0);
    ASSERT_LT(o.metric_at, kFault);
    air_ground_common::Trajectory late;
    for (const auto& pose : o.final_poses)
      if (pose.stamp > 17) late.push_back(pose);
    double scale_error = 1;
    ate(o, late, &scale_error);
    std::printf("an IMU that %s: scale %+.2f %% at the end\n", name.c_str(), 100 * scale_error);
    EXPECT_LT(std::abs(scale_error), 0.03);
    int named = 0;
    for (const VoResult& r : o.frames) {
      if (r.stamp < kFault) continue;
      EXPECT_EQ(r.state, OdometryState::kTracking) << r.stamp;
      const bool late = r.stamp > kFault + 5;
      if (late) EXPECT_LT(std::abs(r.scale - 1), 0.05) << r.stamp;
      named += late && r.imu_at_fault && r.reason.find("tell of different motions") != std::string::npos;
    }
    EXPECT_GT(named, 100) << "of 160 images";
  }
}

// It comes to itself, and is believed again.
TEST(Odometry, AnImuThatIsRightAgainHoldsTheScaleAgain) {
  Options options;
  options.end = 18;
  options.spoil_imu = [](ImuSample& s) {
    if (s.stamp > 9 && s.stamp < 11.5) s = {s.stamp, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  };
  const Outcome o = fly(options);
  ASSERT_GT(o.metric_at, 0);
  ASSERT_LT(o.metric_at, 9);
  EXPECT_TRUE(std::any_of(o.frames.begin(), o.frames.end(), [](const VoResult& r) { return r.imu_at_fault; }));
  for (const VoResult& r : o.frames)
    if (r.stamp > 14) EXPECT_FALSE(r.imu_at_fault) << r.stamp << " " << r.reason;
  EXPECT_LT(std::abs(o.frames.back().scale - 1), 0.03);
  EXPECT_LT(o.frames.back().scale_deviation, 0.04);
  EXPECT_LT(ate(o, o.final_poses), 0.05);
}

TEST(Odometry, OnABusyMachineItIsLateButNoWorse) {
  Options options;
  options.end = 8;
  OdometrySettings settings;
  settings.full_interval = 3;
  settings.reproducible = true;
  const Outcome synchronous = fly(options, settings);
  settings.synchronous = false;
  const Outcome idle = fly(options, settings);
  Outcome busy;
  {
    const BusyMachine hog(3 * std::max(1u, std::thread::hardware_concurrency()));
    busy = fly(options, settings);
  }
  // The same images tracked on the same maps: not a digit differs.
  ASSERT_EQ(idle.frames.size(), busy.frames.size());
  for (std::size_t i = 0; i < idle.frames.size(); ++i) {
    ASSERT_EQ(idle.frames[i].pose_valid, busy.frames[i].pose_valid) << i;
    ASSERT_EQ((idle.frames[i].T_map_camera.matrix() - busy.frames[i].T_map_camera.matrix()).norm(), 0) << i;
  }
  ASSERT_GT(busy.metric_at, 0);
  std::printf("ATE of the published poses: synchronous %.5f m, on a busy machine %.5f m\n",
              ate(synchronous, synchronous.online), ate(busy, busy.online));
  EXPECT_LT(ate(busy, busy.online), 1.2 * ate(synchronous, synchronous.online) + 0.001);
}

}  // namespace
