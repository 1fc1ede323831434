// What becomes of an IMU's messages; in the program of ros_helpers_test.
#include <gtest/gtest.h>

#include <vector>

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

}  // namespace
}  // namespace air_ground_common::ros_utils
