// The odometry with a fisheye of 150 degrees across, beside a pinhole of the same world, flight and inertial unit.
#include <gtest/gtest.h>

#include "air_ground_common/trajectory.h"
#include "mav_vo/odometry.h"
#include "synthetic_camera.h"

using namespace mav_vo;
using air_ground_common::CameraModel;

namespace {

CameraModel sized(double focal) {
  CameraModel c;
  c.width = 600;
  c.height = 400;
  c.fx = c.fy = focal;
  c.cx = 299.5;
  c.cy = 199.5;
  return c;
}

// 150 degrees from left to right.
CameraModel fisheye() {
  CameraModel c = sized(1);
  c.setDistortion("equidistant", {-0.012, 0.023, -0.019, 0.005});
  const double edge = c.distort({std::tan(75 * M_PI / 180), 0}).x();
  c.fx = c.fy = 300 / edge;
  return c;
}

struct Flown {
  air_ground_common::Trajectory truth, estimate;  // of the camera
  int valid = 0, metric = 0;
  double error = 0;  // [m], after aligning heading and position
};

Flown fly(const CameraModel& camera) {
  static const synthetic::PlateWorld world(3);
  const synthetic::Flight flight;
  Odometry odometry(camera, synthetic::T_imu_camera(), Pose::Identity(), OdometrySettings());
  std::mt19937 random(11);
  cv::RNG grain(5);
  const auto samples = flight.imuSamples(0, 10.1, 200, {1.7e-4, 2.9e-3, 2e-5, 6e-4},
                                         {{0.008, -0.012, 0.005}, {0.05, -0.04, 0.06}}, random);
  const auto rays = synthetic::PlateWorld::raysOf(camera);
  std::size_t next = 0;
  Flown flown;
  for (int i = 1; i <= 200; ++i) {
    const double t = 0.05 * i;
    for (; next < samples.size() && samples[next].stamp <= t + 1e-9; ++next) odometry.addImu(samples[next]);
    const Pose T = flight.T_world_imu(t) * synthetic::T_imu_camera();
    const VoResult r = odometry.process(t, world.renderByRays(camera, rays, T, &grain));
    flown.truth.push_back({t, T});
    flown.valid += r.pose_valid;
    flown.metric += r.metric;
  }
  flown.estimate = odometry.trajectory();
  flown.error = air_ground_common::absoluteTrajectoryError(flown.truth, flown.estimate,
                                                           air_ground_common::Alignment::kYawTranslation)
                    .rmse;
  std::printf("%s: %d of 200 located, %d metric, ATE %.4f m of %.2f m\n", camera.distortionName().c_str(), flown.valid,
              flown.metric, flown.error, air_ground_common::pathLength(flown.truth));
  return flown;
}

TEST(WideAngle, FisheyeIsAsAccurateAsAPinhole) {
  const Flown pinhole = fly(sized(330)), wide = fly(fisheye());
  EXPECT_GT(wide.valid, 150);
  EXPECT_GT(wide.metric, 100);
  EXPECT_LT(wide.error, 0.01 * air_ground_common::pathLength(wide.truth));
  EXPECT_LT(wide.error, 1.5 * pinhole.error + 0.01);
}

}  // namespace
