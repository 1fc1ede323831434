#include "air_ground_common/ros/frozen_images.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

#include "air_ground_common/ros/conversions.h"

namespace air_ground_common::ros_utils {
namespace {

/// Texture that moves to the left, without noise.
sensor_msgs::Image view(double shift, int image) {
  cv::Mat pixels(120, 160, CV_8UC1);
  for (int v = 0; v < pixels.rows; ++v)
    for (int u = 0; u < pixels.cols; ++u)
      pixels.at<std::uint8_t>(v, u) =
          cv::saturate_cast<std::uint8_t>(128 + 60 * std::sin(0.31 * (u + shift)) + 50 * std::sin(0.23 * v));
  std_msgs::Header header;
  header.stamp = ros::Time(100 + 0.05 * image);
  return toMsg(pixels, "mono8", header);
}

/// Of the twentieth of a second before an image.
std::deque<ImuCombiner::Sample> samples(int image, double rate, double force) {
  std::deque<ImuCombiner::Sample> imu;
  for (int k = 0; k < 10; ++k) {
    imu.push_back({100 + 0.05 * (image - 1) + 0.005 * k, {0, 0, 0}, {0, 0, 9.81}});
    const double t = imu.back().stamp - 100;
    imu.back().angular_velocity.z() = rate * std::sin(5 * t);
    imu.back().specific_force.x() = force * std::cos(5 * t);
  }
  return imu;
}

TEST(FrozenImages, ARobotThatMovesDoesNotStopFromOneImageToTheNext) {
  FrozenImages frozen;
  for (int i = 0; i < 5; ++i) EXPECT_FALSE(frozen.repeats(view(2.0 * i, i), {}));
  for (int i = 5; i < 30; ++i) EXPECT_TRUE(frozen.repeats(view(8, i), samples(i, 0, 0))) << "a steady drive, to an IMU";
  EXPECT_NEAR(frozen.since(), 100.2, 1e-6);
  EXPECT_FALSE(frozen.repeats(view(60, 30), {}));
}

TEST(FrozenImages, ARobotThatStandsInAWorldWithoutNoiseIsNoHangingDriver) {
  FrozenImages frozen;
  double shift = 0;
  for (int i = 0; i < 200; ++i) {
    shift += 2 * std::max(0.0, 1 - 0.01 * i);  // comes to rest
    EXPECT_FALSE(frozen.repeats(view(shift, i), samples(i, 0, 0))) << i;
  }
  FrozenImages before_the_start;
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(before_the_start.repeats(view(0, i), samples(i, 0.001, 0.02)));
  // It drives off, and its camera goes on to send what it sent.
  int told = 0;
  for (int i = 20; i < 40; ++i) told += before_the_start.repeats(view(0, i), samples(i, 0.4, 0.1));
  EXPECT_GT(told, 15);
  FrozenImages flying;
  flying.repeats(view(0, 0), {});
  for (int i = 1; i < 20; ++i) told = flying.repeats(view(0, i), samples(i, 0, 1));
  EXPECT_TRUE(told);
}

TEST(FrozenImages, DarkImagesAreAlikeAndAnotherCamerasAreNot) {
  FrozenImages frozen;
  std_msgs::Header header;
  for (int i = 0; i < 10; ++i)
    EXPECT_FALSE(frozen.repeats(toMsg(cv::Mat(120, 160, CV_8UC1, cv::Scalar(0)), "mono8", header), samples(i, 1, 3)));
  EXPECT_FALSE(frozen.repeats(sensor_msgs::Image(), {}));
  sensor_msgs::Image cut = view(0, 1);
  cut.data.resize(50);
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(frozen.repeats(cut, {})) << "others refuse it";
  EXPECT_FALSE(frozen.repeats(view(0, 1), {}));
}

}  // namespace
}  // namespace air_ground_common::ros_utils
