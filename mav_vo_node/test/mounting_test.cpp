// An IMU that is mounted otherwise than the odometry is told, or misses the images, and a shutter that it is told
// nothing of, on rendered flights.
#include <gtest/gtest.h>

#include <algorithm>

#include "air_ground_common/units.h"
#include "rendered_flight.h"

using namespace mav_vo;
using air_ground_common::kDegree;

namespace {

// Metric, and in shape, though the IMU is mounted otherwise than told.
TEST(Odometry, FindsHowTheImuIsTurned) {
  for (const Eigen::Vector3d& degrees :
       {Eigen::Vector3d(1.73, 1.73, 1.73), Eigen::Vector3d(5, 0, 0), Eigen::Vector3d(0, 0, 5)}) {
    Options options;
    options.flight.wobble = 0.15;
    options.R_given_imu = air_ground_common::expSO3(Eigen::Vector3d(kDegree * degrees));
    const Outcome o = fly(options);
    const VoResult& last = o.frames.back();
    const double off = air_ground_common::rotationAngle(last.R_given_imu, options.R_given_imu) / kDegree;
    double scale_error = 1;
    const double error = o.metric_at > 0 ? ate(o, o.final_poses, &scale_error) : 1;
    std::printf(
        "IMU turned by %.1f %.1f %.1f degrees: found to %.2f (+- %.2f), metric after %.2f s, ATE %.4f m, scale "
        "%+.2f %%\n",
        degrees.x(), degrees.y(), degrees.z(), off, last.imu_rotation_stddev / kDegree, o.metric_at, error,
        100 * scale_error);
    EXPECT_LT(off, 1.0);
    EXPECT_EQ(last.map_id, o.frames.front().map_id) << "a map is kept when the mounting turns out";
    ASSERT_GT(o.metric_at, 0) << last.reason;
    EXPECT_LT(std::abs(scale_error), 0.02);
    EXPECT_LT(error, 0.015 * air_ground_common::pathLength(o.truth));
  }
}

// Too little for the tracks to be sure of; the map is. With 0.5 degrees, and with none.
TEST(Odometry, TheMapTellsHowTheImuIsTurned) {
  for (const Eigen::Vector3d& degrees : {Eigen::Vector3d(0.3, -0.3, 0.25), Eigen::Vector3d(0, 0, 0)}) {
    Options options;
    options.flight.wobble = 0.15;
    options.R_given_imu = air_ground_common::expSO3(Eigen::Vector3d(kDegree * degrees));
    options.end = 22;
    const Outcome o = fly(options);
    const VoResult& last = o.frames.back();
    const double off = air_ground_common::rotationAngle(last.R_given_imu, options.R_given_imu) / kDegree;
    ASSERT_GT(o.metric_at, 0) << last.reason;
    double scale_error = 1;
    const double error = ate(o, o.final_poses, &scale_error);
    std::printf("IMU turned by %.1f degrees: found to %.2f, ATE %.4f m, scale %+.2f %%\n", degrees.norm(), off, error,
                100 * scale_error);
    EXPECT_LT(off, 0.25);
    EXPECT_LT(std::abs(scale_error), 0.01);
  }
}

// A camera on USB that is stamped when its image arrives, or drivers on two computers.
TEST(Odometry, FindsClocksThatAreFarApart) {
  for (const double shift : {0.25, -0.4}) {
    Options options;
    options.flight.wobble = 0.15;
    options.imu_shift = shift;
    options.end = 16;
    const Outcome o = fly(options);
    const VoResult& last = o.frames.back();
    std::printf("clocks %.2f s apart: found %.4f, metric after %.2f s\n", shift, last.time_offset, o.metric_at);
    EXPECT_NEAR(last.time_offset, shift, 0.006);
    ASSERT_GT(o.metric_at, 0) << last.reason;
    double scale_error = 1;
    EXPECT_LT(ate(o, o.final_poses, &scale_error), 0.015 * air_ground_common::pathLength(o.truth));
    EXPECT_LT(std::abs(scale_error), 0.02);
  }
}

TEST(Odometry, NamesAnImuThatMissesTheImages) {
  Options slow, other_clock;
  slow.end = other_clock.end = 6;
  slow.nan_imu = [](double t) { return std::fmod(t + 10.001, 0.2) > 0.002; };
  other_clock.imu_shift = -1000;
  for (const bool of_other_clock : {false, true}) {
    const Outcome o = fly(of_other_clock ? other_clock : slow);
    const VoResult& last = o.frames.back();
    EXPECT_EQ(last.state, OdometryState::kScaling);
    EXPECT_EQ(last.reason.find("metric scale is not known: " +
                               std::string(of_other_clock ? "the IMU's stamps end" : "IMU at 5 Hz: steadily")),
              0u)
        << last.reason;
    EXPECT_TRUE(last.imu_at_fault) << "to accelerate is no help";
  }
}

TEST(Odometry, FindsTheReadoutTime) {
  Options options;
  options.flight.wobble = 0.15;
  options.readout = 0.025;
  const Outcome o = fly(options);
  const VoResult& last = o.frames.back();
  std::printf("readout time %.2f +- %.2f ms, ATE %.4f m\n", 1e3 * last.readout_time, 1e3 * last.readout_time_stddev,
              ate(o, o.final_poses));
  EXPECT_NEAR(last.readout_time, options.readout, 0.004);
  EXPECT_LT(last.readout_time_stddev, 0.004);
  ASSERT_GT(o.metric_at, 0) << last.reason;
  EXPECT_LT(ate(o, o.final_poses), 0.01 * air_ground_common::pathLength(o.truth));
}

// What the map has seen by then is put right; it is not begun anew.
TEST(Odometry, KeepsItsMapWhenTheReadoutTimeTurnsOut) {
  Options options;
  options.begin = 4;
  options.end = 14;
  options.flight.wobble = 0.3;
  options.readout = 0.03;
  const Outcome o = fly(options);
  const VoResult& last = o.frames.back();
  ASSERT_GT(o.metric_at, 0) << last.reason;
  const auto found = std::find_if(o.frames.begin(), o.frames.end(), [](const auto& r) { return r.readout_time != 0; });
  double scale_error = 1;
  const double error = ate(o, o.final_poses, &scale_error);
  std::printf("readout time found after %.2f s, metric after %.2f s, map %u, ATE %.4f m, scale error %+.3f %%\n",
              found->stamp - options.begin, o.metric_at - options.begin, last.map_id, error, 100 * scale_error);
  EXPECT_LT(found->stamp, o.metric_at) << "not what this test is about";
  const auto first = std::find_if(o.frames.begin(), o.frames.end(), [](const auto& r) { return r.pose_valid; });
  for (auto r = first; r != o.frames.end(); ++r) EXPECT_TRUE(r->pose_valid) << r->stamp << " " << r->reason;
  EXPECT_EQ(last.map_id, first->map_id);
  EXPECT_LT(error, 0.01 * air_ground_common::pathLength(o.truth));
}

// A drone's video: no IMU, and nothing that says how the camera is mounted.
TEST(Odometry, TheFlightTellsWhatIsUpWhereNothingElseDoes) {
  Options options;
  options.imu = false;
  OdometrySettings settings;
  settings.use_imu = false;
  Pose ahead = Pose::Identity();
  ahead.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;  // the camera of synthetic_flight.h looks down
  for (const Pose& T_base_camera : {synthetic::T_imu_camera(), ahead, Pose(Pose::Identity())}) {
    Odometry odometry(synthetic::camera(), T_base_camera, Pose::Identity(), settings);
    const Outcome o = fly(options, settings, &odometry);
    int told = 0;
    for (const VoResult& r : o.frames) {
      if (!r.pose_valid || !(r.vertical.stddev > 0)) continue;
      const Pose T = options.flight.T_world_imu(r.stamp) * synthetic::T_imu_camera();
      const Eigen::Vector3d up = r.T_map_camera.linear() * T.linear().transpose() * Eigen::Vector3d::UnitZ();
      EXPECT_LT(std::acos(std::min(1.0, up.dot(r.vertical.up))), 3 * r.vertical.stddev) << "at " << r.stamp << " s";
      ++told;
    }
    EXPECT_GT(told, 50);
    std::printf("level to %.2f deg\n", o.frames.back().vertical.stddev / kDegree);
  }
}

}  // namespace
