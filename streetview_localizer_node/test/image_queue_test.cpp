// Which images the node's worker gets.
#include "../src/ros/image_queue.h"

#include <gtest/gtest.h>
#include <ros/ros.h>

#include <opencv2/imgcodecs.hpp>
#include <thread>
#include <vector>

#include "air_ground_common/ros/node_testing.h"

namespace streetview_localizer {
namespace {

namespace ru = air_ground_common::ros_utils;

ru::Calibration calibration() {
  ru::Calibration c;
  c.camera.width = 64, c.camera.height = 48;
  c.camera.fx = c.camera.fy = 60, c.camera.cx = 31.5, c.camera.cy = 23.5;
  c.info.header.frame_id = "camera";
  return c;
}

ru::ImageMessage compressed(double stamp, const std::vector<uchar>& data) {
  auto message = boost::make_shared<sensor_msgs::CompressedImage>();
  message->header.stamp = ros::Time(stamp);
  message->format = "jpeg";
  message->data = data;
  return {nullptr, message};
}

ru::ImageMessage picture(double stamp, const cv::Size& size = {64, 48}) {
  std::vector<uchar> jpeg;
  cv::imencode(".jpg", cv::Mat(size, CV_8UC3, cv::Scalar::all(90)), jpeg);
  return compressed(stamp, jpeg);
}

ru::ImageMessage broken(double stamp) { return compressed(stamp, {0xFF, 0xD8, 0xFF}); }

std::string problemOf(const ru::ImageMessage& message) {
  try {
    message.pixels();
  } catch (const std::exception& e) {
    return std::string("images that could not be used: ") + e.what();
  }
  return "";
}

const auto kNoAttitudes = [] { return false; };

// A camera of 30 images a second, of which the worker takes two: to decompress all of them would cost more.
TEST(ImageQueue, DecompressesOnlyWhatIsWorkedOn) {
  const NodeSettings settings;
  ru::NodeHealth health("streetview_localizer");
  ImageQueue queue(settings, health);
  queue.setCamera(calibration());
  const std::string problem = problemOf(broken(1));
  ASSERT_FALSE(problem.empty());
  for (int i = 0; i < 20; ++i) queue.add(broken(1 + 0.03 * i));
  queue.add(picture(2));
  auto job = queue.next(kNoAttitudes);
  ASSERT_TRUE(job);
  EXPECT_EQ(job->image->header.stamp, ros::Time(2));
  EXPECT_EQ(job->camera_frame, "camera");
  EXPECT_EQ(health.counted(problem), 0u);
  EXPECT_EQ(health.counted("images skipped for newer ones while one was worked on"), 20u);

  // What cannot be used is counted, and the next one waited for.
  queue.add(broken(3));
  std::thread worker([&] { job = queue.next(kNoAttitudes); });
  EXPECT_TRUE(ru::spinUntil([&] { return health.counted(problem) == 1; }));
  queue.add(picture(4, {32, 24}));
  const std::string small = "images of another size than their calibration (32 x 24 against 64 x 48)";
  EXPECT_TRUE(ru::spinUntil([&] { return health.counted(small) == 1; }));
  queue.add(picture(5));
  worker.join();
  ASSERT_TRUE(job);
  EXPECT_EQ(job->image->header.stamp, ros::Time(5));
}

TEST(ImageQueue, KeepsItsPeriodAndForgetsIt) {
  NodeSettings settings;
  settings.min_period = 1;
  ru::NodeHealth health("streetview_localizer");
  ImageQueue queue(settings, health);
  queue.setCamera(calibration());
  queue.add(picture(10));
  ASSERT_TRUE(queue.next(kNoAttitudes));
  queue.add(picture(10.9));  // too early
  queue.add(picture(11));
  queue.add(picture(10.95));
  auto job = queue.next(kNoAttitudes);
  ASSERT_TRUE(job);
  EXPECT_EQ(job->image->header.stamp, ros::Time(11));
  EXPECT_TRUE(queue.isCurrent(*job));
  queue.add(picture(13));
  queue.reset();  // a looped bag
  EXPECT_FALSE(queue.isCurrent(*job));
  queue.add(picture(2));
  job = queue.next(kNoAttitudes);
  ASSERT_TRUE(job);
  EXPECT_EQ(job->image->header.stamp, ros::Time(2));
  queue.stop();
  EXPECT_FALSE(queue.next(kNoAttitudes));
}

TEST(ImageQueue, OdometryThatAgreesWithAGyroTellsThatNothingFlipsTheImages) {
  const NodeSettings settings;
  ru::NodeHealth health("streetview_localizer");
  ImageQueue queue(settings, health);
  queue.setCamera(calibration());
  const auto notMirrored = [&](double stamp) {
    queue.add(picture(stamp));
    return queue.priorFor(*queue.next(kNoAttitudes), Pose::Identity(), true).not_mirrored;
  };
  air_ground::VoStatus status;
  status.header.stamp = ros::Time(10);
  status.state = status.STATE_TRACKING;
  queue.addStatus(status);
  EXPECT_FALSE(notMirrored(10)) << "metric by an alignment, not by an IMU";
  status.tilt_stddev = 0.01;
  status.state = status.STATE_SCALING;
  queue.addStatus(status);
  EXPECT_FALSE(notMirrored(10.1)) << "not metric yet";
  status.state = status.STATE_TRACKING;
  queue.addStatus(status);
  EXPECT_TRUE(notMirrored(10.2));
  EXPECT_FALSE(notMirrored(60)) << "that was long ago: another camera may be there";
  queue.reset();
  EXPECT_FALSE(notMirrored(10.3));
}

}  // namespace
}  // namespace streetview_localizer

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "image_queue_test");
  const ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
