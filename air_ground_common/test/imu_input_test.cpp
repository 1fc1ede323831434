// What becomes of the messages of IMU and camera; in the program of ros_helpers_test.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/ros/sensor_input.h"

namespace air_ground_common::ros_utils {
namespace {

TEST(ImuInput, TakesWhatWasMeasuredAlone) {
  NodeHealth health("imu_input_test");
  sensor_msgs::Imu message;
  message.header.stamp = ros::Time(10);
  message.angular_velocity.z = 0.3;
  message.linear_acceleration.z = 9.81;
  ImuInput united(health, false), apart(health, true);
  ASSERT_EQ(united.read(message).size(), 1u);
  EXPECT_EQ(united.read(message)[0].angular_velocity.z(), 0.3);
  sensor_msgs::Imu no_rate = message, no_force = message;
  no_rate.angular_velocity_covariance[0] = -1;
  no_force.linear_acceleration_covariance[0] = -1;
  EXPECT_TRUE(united.read(no_rate).empty());
  EXPECT_TRUE(united.read(no_force).empty());
  EXPECT_TRUE(apart.read(no_rate).empty());

  for (int i = 0; i < 2; ++i) {
    sensor_msgs::Imu force = no_rate;
    force.header.stamp = ros::Time(9.99 + 0.02 * i);
    force.linear_acceleration.z = 9 + i;
    const auto samples =
        i == 0 ? apart.readAccelerometer(force) : (apart.read(no_force), apart.readAccelerometer(force));
    ASSERT_EQ(samples.size(), i == 0 ? 0u : 1u);
    if (i == 0) continue;
    EXPECT_NEAR(samples[0].stamp, 10, 1e-9);
    EXPECT_NEAR(samples[0].specific_force.z(), 9.5, 1e-6);
    EXPECT_EQ(samples[0].angular_velocity.z(), 0.3);
  }
}

TEST(ImuInput, SpreadsPacketsOfAnAccelerometerOfItsOwn) {
  NodeHealth health("imu_packets_test");
  ImuInput apart(health, true);
  std::vector<ImuInput::Sample> samples;
  const auto keep = [&](const std::vector<ImuInput::Sample>& more) {
    samples.insert(samples.end(), more.begin(), more.end());
  };
  for (int packet = 1; packet <= 80; ++packet) {  // 200 Hz and 100 Hz; the force rises by 1 m/s^2 each second
    sensor_msgs::Imu message;
    message.header.stamp = ros::Time(10 + 0.04 * packet);
    for (int i = 0; i < 8; ++i) keep(apart.read(message));
    for (int i = 3; i >= 0; --i) {
      message.linear_acceleration.z = 9 + 0.04 * packet - 0.01 * i;
      keep(apart.readAccelerometer(message));
    }
  }
  ASSERT_GT(samples.size(), 500u);
  for (std::size_t i = samples.size() - 200; i < samples.size(); ++i) {
    EXPECT_NEAR(samples[i].stamp - samples[i - 1].stamp, 0.005, 1e-6);
    EXPECT_NEAR(samples[i].specific_force.z(), samples[i].stamp - 1, 1e-6);
  }
}

TEST(ImuInput, CountsWhatTheRangeCutsOff) {
  NodeHealth health("imu_range_test");
  const NodeDiagnostics diagnostics(ros::this_node::getName().substr(1));
  ImuInput input(health, false);
  for (int i = 0; i < 40; ++i) {
    sensor_msgs::Imu message;
    message.header.stamp = ros::Time(10 + 0.005 * i);
    message.linear_acceleration.z = i % 2 == 0 ? 9.81 : 39.2266;
    EXPECT_EQ(input.read(message).size(), 1u) << "it is still the best there is";
  }
  EXPECT_TRUE(diagnostics.await("accelerations cut off at 39.2 m/s^2, the end of the sensor's range", 11));
  EXPECT_EQ(diagnostics.counted("turn rates cut off"), 0);
}

TEST(ImuInput, JudgesTheUnitAgainAndAgain) {
  NodeHealth health("imu_unit_test");
  ImuInput input(health, false);
  double stamp = 10;
  const auto feed = [&](double force, int samples) {
    for (int i = 0; i < samples; ++i) {
      sensor_msgs::Imu message;
      message.header.stamp = ros::Time(stamp += 0.005);
      message.linear_acceleration.z = force;
      input.read(message);
    }
    return input.problem();
  };
  EXPECT_EQ(feed(0, 150), "");
  EXPECT_NE(feed(0, 60).find("not about 9.81 m/s^2"), std::string::npos) << "zeros while it warms up";
  EXPECT_EQ(feed(9.81, 400), "");
  EXPECT_NE(feed(1, 400).find("not about 9.81 m/s^2"), std::string::npos);
  input.reset();
  EXPECT_EQ(feed(9.81, 600), "");
}

sensor_msgs::CameraInfo autofocus(double fx, double cx, double k1) {
  sensor_msgs::CameraInfo info;
  info.width = 1280;
  info.height = 720;
  info.distortion_model = "plumb_bob";
  info.D = {k1, 0.01, 0, 0, 0};
  info.K = {fx, 0, cx, 0, fx + 1, 360, 0, 0, 1};
  info.R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info.P = {fx, 0, cx, 0, 0, fx + 1, 360, 0, 0, 0, 1, 0};
  return info;
}

TEST(Calibration, AnAutofocusIsNoOtherCamera) {
  const sensor_msgs::CameraInfo info = autofocus(1000, 640, 0.05);
  EXPECT_TRUE(sameCalibration(info, autofocus(1000.7, 639.6, 0.05)));
  EXPECT_TRUE(sameCalibration(info, autofocus(997.5, 642.5, 0.05)));
  EXPECT_FALSE(sameCalibration(info, autofocus(1003.5, 640, 0.05)));
  EXPECT_FALSE(sameCalibration(info, autofocus(1000, 636, 0.05)));
  // The corners lie 0.73 off the axis: k1 moves them by 0.73^3 = 0.4 times itself, 1000 px away.
  EXPECT_TRUE(sameCalibration(info, autofocus(1000, 640, 0.052)));
  EXPECT_FALSE(sameCalibration(info, autofocus(1000, 640, 0.056)));
  sensor_msgs::CameraInfo other = info;
  other.D.resize(4);
  EXPECT_TRUE(sameCalibration(info, other)) << "what is left out is zero";
  other.D.assign(20, 0.1);
  EXPECT_FALSE(sameCalibration(info, other)) << "no such model";
  other = info;
  other.distortion_model = "rational_polynomial";
  EXPECT_FALSE(sameCalibration(info, other));
  other = info;
  other.K[1] = 0.1;  // skew is none of it
  EXPECT_FALSE(sameCalibration(info, other));
  other = info;
  other.K[0] = NAN;
  EXPECT_FALSE(sameCalibration(info, other));
  other = info;
  other.roi.x_offset = 1;
  EXPECT_FALSE(sameCalibration(info, other));
}

}  // namespace
}  // namespace air_ground_common::ros_utils
