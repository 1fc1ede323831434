// What the recorder writes: stamps, topics and types, as the faults' definitions say.
#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <rosbag/view.h>

#include <cmath>
#include <cstdio>
#include <map>
#include <opencv2/imgcodecs.hpp>

#include "recorder.h"

namespace air_ground_sim {
namespace {

SimConfig smallConfig() {
  SimConfig c = SimConfig::defaults();
  c.world.kind = WorldKind::kFlat;
  c.world.floor_size = 8;
  c.world.room_height = 0;
  c.world.texel = 0.02;
  c.lane.points = {{2.5, -1.2}, {2.7, 0.2}, {2.3, 1.6}, {1.2, 2.5}, {-0.3, 2.7}};
  c.flight.duration = 6;
  c.mav_camera.samples = c.ground_camera.samples = 1;
  c.mav_camera.rate = c.ground_camera.rate = 2;
  return c;
}

class Recorder : public testing::Test {
 protected:
  void TearDown() override {
    bag_.close();
    std::remove(path_.c_str());
  }
  void record(const SimConfig& c) {
    recording_ = std::make_unique<Recording>(c, 3);
    RecorderOptions o;
    o.quiet = true;
    BagRecorder(recording_.get(), o, path_).run();
    bag_.open(path_, rosbag::bagmode::Read);
  }
  template <class Message>
  std::vector<Message> all(const std::string& topic) {
    std::vector<Message> messages;
    for (const auto& m : rosbag::View(bag_, rosbag::TopicQuery(topic)))
      if (const auto message = m.instantiate<Message>()) messages.push_back(*message);
    return messages;
  }
  static double timeOf(const ros::Time& stamp) { return (stamp - ros::Time(kRecordingStart)).toSec(); }

  std::string path_ = testing::TempDir() + "/air_ground_recorder_test.bag";
  std::unique_ptr<Recording> recording_;
  rosbag::Bag bag_;
};

TEST_F(Recorder, WithoutFaultsEveryStampIsTheTrueTime) {
  record(smallConfig());
  const auto imu = all<sensor_msgs::Imu>("/mav/imu/data");
  ASSERT_EQ(imu.size(), 1201u);  // 6 s at 200 Hz
  EXPECT_NEAR(timeOf(imu[1000].header.stamp), 5.0, 1e-6);
  EXPECT_NEAR(timeOf(all<sensor_msgs::Image>("/mav/camera/image_raw").at(3).header.stamp), 0.05 + 3 / 2.0, 1e-6);
  EXPECT_EQ(all<sensor_msgs::Image>("/ground/rgb/image_raw").size(), 12u);
  EXPECT_EQ(all<sensor_msgs::MagneticField>("/ground/imu/mag").size(), 0u);
  const auto transforms = all<tf2_msgs::TFMessage>("/tf_static");
  ASSERT_EQ(transforms.size(), 1u);
  EXPECT_EQ(transforms[0].transforms.size(), 4u);
}

// A reading taken at the time t has the stamp t + offset: the IMU says at its stamp what was true an offset earlier.
TEST_F(Recorder, InertialStampsAreLateByTheOffset) {
  SimConfig c = smallConfig();
  c.faults.time_offset = 0.04;
  c.imu.gyro_noise = c.imu.gyro_bias = c.imu.gyro_bias_walk = 0;
  record(c);
  const auto imu = all<sensor_msgs::Imu>("/mav/imu/data");
  for (const std::size_t i : {900u, 1100u}) {
    const double stamp = timeOf(imu.at(i).header.stamp);
    EXPECT_NEAR(stamp, i / 200.0 + 0.04, 1e-6);
    const Eigen::Vector3d truth = recording_->mav().state(stamp - 0.04).angular_velocity;
    const auto& w = imu[i].angular_velocity;
    EXPECT_LT((Eigen::Vector3d(w.x, w.y, w.z) - truth).norm(), 1e-6);
  }
  EXPECT_NEAR(timeOf(all<sensor_msgs::Image>("/mav/camera/image_raw").at(3).header.stamp), 1.55, 1e-6);
  double last = -1;
  for (const auto& m : rosbag::View(bag_)) {
    EXPECT_GE(timeOf(m.getTime()), last);
    last = timeOf(m.getTime());
  }
}

TEST_F(Recorder, TheGroundRobotsClockMayBeAhead) {
  SimConfig c = smallConfig();
  c.faults.clock_offset = 1.5;
  c.imu.ground_magnetometer = true;
  record(c);
  EXPECT_NEAR(timeOf(all<sensor_msgs::Image>("/ground/depth/image_raw").at(0).header.stamp), 1.55, 1e-6);
  EXPECT_NEAR(timeOf(all<sensor_msgs::Imu>("/ground/imu/data").at(0).header.stamp), 1.5, 1e-6);
  EXPECT_NEAR(timeOf(all<geometry_msgs::PoseStamped>("/ground_truth/ground").at(0).header.stamp), 1.5, 1e-6);
  EXPECT_NEAR(timeOf(all<sensor_msgs::Imu>("/mav/imu/data").at(0).header.stamp), 0, 1e-6);
  // The magnetometer sees the Earth's field turned into its frame.
  const auto mag = all<sensor_msgs::MagneticField>("/ground/imu/mag");
  ASSERT_EQ(mag.size(), 301u);
  const Eigen::Matrix3d R_world_imu = recording_->ground().pose(3.0).linear();
  const auto& b = mag[150].magnetic_field;
  EXPECT_LT((R_world_imu * Eigen::Vector3d(b.x, b.y, b.z) - earthMagneticField()).norm(), 4 * 3e-7);
}

TEST_F(Recorder, DepthMayBeLate) {
  SimConfig c = smallConfig();
  c.faults.depth_delay = 0.015;
  record(c);
  const auto depth = all<sensor_msgs::Image>("/ground/depth/image_raw"),
             colour = all<sensor_msgs::Image>("/ground/rgb/image_raw");
  ASSERT_EQ(depth.size(), colour.size());
  for (std::size_t i = 0; i < depth.size(); ++i)
    EXPECT_NEAR((depth[i].header.stamp - colour[i].header.stamp).toSec(), 0.015, 1e-6);
  EXPECT_NEAR(timeOf(colour[0].header.stamp), 0.05, 1e-6);
}

TEST_F(Recorder, JpegComesOnTheCompressedTopicInPlaceOfTheImage) {
  SimConfig c = smallConfig();
  record(c);
  const auto raw = all<sensor_msgs::Image>("/ground/rgb/image_raw");
  bag_.close();
  c.faults.jpeg_quality = 90;
  record(c);
  EXPECT_TRUE(all<sensor_msgs::Image>("/ground/rgb/image_raw").empty());
  EXPECT_EQ(all<sensor_msgs::Image>("/ground/depth/image_raw").size(), raw.size());
  EXPECT_EQ(all<sensor_msgs::CompressedImage>("/mav/camera/image_raw/compressed").at(0).format,
            "mono8; jpeg compressed ");
  const auto jpeg = all<sensor_msgs::CompressedImage>("/ground/rgb/image_raw/compressed");
  ASSERT_EQ(jpeg.size(), raw.size());
  EXPECT_EQ(jpeg[0].header.stamp, raw[0].header.stamp);
  EXPECT_EQ(jpeg[0].header.frame_id, "ground_camera_optical_frame");
  EXPECT_EQ(jpeg[0].format, "rgb8; jpeg compressed bgr8");
  const cv::Mat bgr = cv::imdecode(jpeg[0].data, cv::IMREAD_COLOR);
  ASSERT_EQ(bgr.rows, 480);
  double error[3] = {0, 0, 0};  // of each channel: red stays red
  for (int y = 0; y < bgr.rows; ++y)
    for (int x = 0; x < bgr.cols; ++x)
      for (int k = 0; k < 3; ++k)
        error[k] += std::abs(bgr.at<cv::Vec3b>(y, x)[2 - k] - raw[0].data[3 * (640 * y + x) + k]) / (640.0 * 480);
  for (const double e : error) EXPECT_LT(e, 8);
}

TEST_F(Recorder, CalibrationsMayBePublishedWrong) {
  SimConfig c = smallConfig();
  record(c);
  const auto right = all<sensor_msgs::CameraInfo>("/mav/camera/camera_info").at(0);
  const auto image = all<sensor_msgs::Image>("/mav/camera/image_raw").at(0);
  bag_.close();
  c.faults.radial_error = 0.04;
  c.faults.focal_error = -0.02;
  record(c);
  const auto wrong = all<sensor_msgs::CameraInfo>("/mav/camera/camera_info").at(0);
  EXPECT_NEAR(wrong.D.at(0), right.D.at(0) + 0.04, 1e-12);
  EXPECT_NEAR(wrong.K[0], 0.98 * right.K[0], 1e-9);
  EXPECT_NEAR(wrong.P[5], 0.98 * right.P[5], 1e-9);
  EXPECT_EQ(wrong.K[2], right.K[2]);
  EXPECT_EQ(all<sensor_msgs::Image>("/mav/camera/image_raw").at(0).data, image.data) << "the image is the camera's";
  EXPECT_NEAR(all<sensor_msgs::CameraInfo>("/ground/rgb/camera_info").at(0).D.at(0),
              c.ground_camera.camera.distortionCoefficients().at(0) + 0.04, 1e-12);
}

TEST_F(Recorder, LostImagesLackWithTheirCalibrations) {
  SimConfig c = smallConfig();
  c.faults.lost_images = 0.5;
  record(c);
  const auto images = all<sensor_msgs::Image>("/mav/camera/image_raw");
  EXPECT_GT(images.size(), 0u);
  EXPECT_LT(images.size(), 12u);
  EXPECT_EQ(all<sensor_msgs::CameraInfo>("/mav/camera/camera_info").size(), images.size());
  EXPECT_EQ(all<sensor_msgs::Image>("/ground/depth/image_raw").size(),
            all<sensor_msgs::Image>("/ground/rgb/image_raw").size());
  for (const auto& m : images) EXPECT_NEAR(timeOf(m.header.stamp), 0.05 + m.header.seq / 2.0, 1e-6);
}

TEST_F(Recorder, StaticTransformsMayBeSplitOrComeFromSeveralPublishers) {
  for (const StaticTransforms mode : {StaticTransforms::kSplit, StaticTransforms::kPublishers}) {
    SimConfig c = smallConfig();
    c.faults.tf_static = mode;
    record(c);
    EXPECT_EQ(all<tf2_msgs::TFMessage>("/tf_static").size(), 4u);
    std::size_t latching = 0, connections = 0;
    rosbag::View view(bag_, rosbag::TopicQuery("/tf_static"));
    for (const rosbag::ConnectionInfo* info : view.getConnections()) {
      ++connections;
      latching += info->header->count("latching");
    }
    EXPECT_EQ(connections, mode == StaticTransforms::kSplit ? 1u : 4u);
    EXPECT_EQ(latching, mode == StaticTransforms::kSplit ? 0u : 4u);
    bag_.close();
  }
}

}  // namespace
}  // namespace air_ground_sim
