// What the node says while something is lacking, and how it takes what others record: compressed images, calibration
// and mountings that come late and are sent once. The cases follow one upon the other.
#include <air_ground/VoStatus.h>
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <rosgraph_msgs/Log.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Imu.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "synthetic_camera.h"

namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::VoStatus;
using ros_utils::spinUntil;
using synthetic::Pose;

class Inputs : public testing::Test {
 protected:
  Inputs() {
    image_ = handle_.advertise<sensor_msgs::CompressedImage>("mav/camera/image_raw/compressed", 400);
    info_ = handle_.advertise<sensor_msgs::CameraInfo>("mav/camera/camera_info", 10);
    imu_ = handle_.advertise<sensor_msgs::Imu>("mav/imu/data", 1000);
    static_tf_ = handle_.advertise<tf2_msgs::TFMessage>("/tf_static", 10);  // not latched
    subscribers_ = {
        handle_.subscribe<VoStatus>("mav/vo_status", 1000,
                                    [this](const VoStatus::ConstPtr& m) { status_.push_back(*m); }),
        handle_.subscribe<rosgraph_msgs::Log>("/rosout", 1000, [this](const rosgraph_msgs::Log::ConstPtr& m) {
          if (m->level >= rosgraph_msgs::Log::WARN) lines_.push_back(m->name + ": " + m->msg);
        })};
    for (const Pose& T : {synthetic::T_imu_camera(), Pose(Pose::Identity())}) {
      geometry_msgs::TransformStamped transform;
      transform.header.frame_id = "mav_base_link";
      transform.child_frame_id = mountings_.empty() ? "mav_camera_optical_frame" : "mav_imu_link";
      transform.transform = ros_utils::toTransformMsg(T);
      mountings_.emplace_back();
      mountings_.back().transforms.push_back(transform);
    }
    cv::imencode(".png", world_.render(synthetic::camera(), flight_.T_world_imu(0) * synthetic::T_imu_camera()), png_);
  }

  /// Publishes images of a vehicle at rest, and its IMU, at 20 Hz until `done`.
  bool rest(const std::function<bool()>& done, bool with_info) {
    for (int i = 0; i < 600; ++i) {
      stamp_ += ros::Duration(0.05);
      if (with_info) info_.publish(ros_utils::toMsg(synthetic::camera(), header("mav_camera_optical_frame", stamp_)));
      for (int k = 0; k < 10; ++k) {
        sensor_msgs::Imu msg;
        msg.header = header("mav_imu_link", stamp_ - ros::Duration(0.04) + ros::Duration(0.005 * k));
        msg.linear_acceleration.z = 9.81;
        imu_.publish(msg);
      }
      publishImage(stamp_);
      if (spinUntil(done, 10)) return true;
    }
    return false;
  }

  void publishImage(const ros::Time& stamp) {
    sensor_msgs::CompressedImage msg;
    msg.header = header("mav_camera_optical_frame", stamp);
    msg.format = "mono8; png compressed mono8";
    msg.data = png_;
    image_.publish(msg);
  }

  static std_msgs::Header header(const std::string& frame, const ros::Time& stamp) {
    std_msgs::Header header;
    header.frame_id = frame;
    header.stamp = stamp;
    return header;
  }

  std::ptrdiff_t said(const std::string& node, const std::string& part) const {
    return std::count_if(lines_.begin(), lines_.end(), [&](const std::string& line) {
      return line.rfind(node + ": ", 0) == 0 && line.find(part) != std::string::npos;
    });
  }

  ros::NodeHandle handle_;
  synthetic::PlateWorld world_{3};
  synthetic::Flight flight_;
  ros::Publisher image_, info_, imu_, static_tf_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<tf2_msgs::TFMessage> mountings_;
  std::vector<unsigned char> png_;
  std::vector<VoStatus> status_;
  std::vector<std::string> lines_;
  ros_utils::NodeDiagnostics diagnostics_{"mav_vo"};
  ros::Time stamp_{1000.0};
};

TEST_F(Inputs, EveryReasonIsSaidAndWhatComesLateIsTaken) {
  ASSERT_TRUE(spinUntil([&] {
    return image_.getNumSubscribers() > 0 && info_.getNumSubscribers() > 0 && imu_.getNumSubscribers() > 0 &&
           static_tf_.getNumSubscribers() > 1 && subscribers_[0].getNumPublishers() > 0 &&
           subscribers_[1].getNumPublishers() > 2;
  }));
  // No calibration.
  const std::string no_calibration = "no calibration has come on /mav/camera/camera_info";
  EXPECT_TRUE(rest([&] { return said("/mav_vo", no_calibration) > 0; }, false));
  ASSERT_FALSE(status_.empty());
  EXPECT_EQ(status_.back().state, VoStatus::STATE_WAITING);
  EXPECT_NE(status_.back().reason.find(no_calibration), std::string::npos) << status_.back().reason;
  // No mounting.
  const std::string edge = "no transform 'mav_base_link' <- 'mav_camera_optical_frame'";
  EXPECT_TRUE(rest([&] { return said("/mav_vo", edge) > 0; }, true));
  EXPECT_GT(said("/mav_vo", "base_camera"), 0);
  EXPECT_TRUE(rest([&] { return !status_.empty() && status_.back().reason.find(edge) != std::string::npos; }, true));
  EXPECT_TRUE(rest([&] { return diagnostics_.counted("images without the mounting of the camera") > 0; }, true));
  // Two messages, each sent once.
  for (const auto& mounting : mountings_) static_tf_.publish(mounting);
  EXPECT_TRUE(rest([&] { return !status_.empty() && status_.back().state == VoStatus::STATE_INITIALIZING; }, true));
  EXPECT_EQ(said("/mav_vo", no_calibration), 1) << "once";
  EXPECT_EQ(said("/mav_vo", edge), 1) << "once";
}

TEST_F(Inputs, ANodeThatIsBehindDropsTheOldestImages) {
  ASSERT_TRUE(spinUntil([&] {
    return image_.getNumSubscribers() > 0 && subscribers_[0].getNumPublishers() > 0 &&
           subscribers_[1].getNumPublishers() > 2;
  }));
  stamp_ = ros::Time(2000.0);
  ASSERT_TRUE(rest([&] { return !status_.empty() && status_.back().header.stamp > ros::Time(2000.0); }, true));
  const ros::Time begin = stamp_;
  ASSERT_TRUE(diagnostics_.refresh());
  const std::string late = "images dropped: further behind than max_latency";
  const int before = diagnostics_.counted(late);
  for (int i = 0; i < 200; ++i) publishImage(stamp_ += ros::Duration(0.05));  // ten seconds at once
  EXPECT_TRUE(rest([&] { return diagnostics_.counted(late) > before + 100; }, true));
  EXPECT_TRUE(rest([&] { return status_.back().header.stamp > begin + ros::Duration(9); }, true));
}

TEST_F(Inputs, StampsThatWereNotSetAreDropped) {
  ASSERT_TRUE(spinUntil([&] {
    return image_.getNumSubscribers() > 0 && imu_.getNumSubscribers() > 0 && subscribers_[0].getNumPublishers() > 0;
  }));
  stamp_ = ros::Time(3000.0);
  ASSERT_TRUE(rest([&] { return !status_.empty() && status_.back().header.stamp > ros::Time(3000.0); }, true));
  ASSERT_TRUE(diagnostics_.refresh());
  const std::string dropped = "messages whose stamp was not set dropped";
  const int before = diagnostics_.counted(dropped);
  ros::Time none;
  none.sec = none.nsec = 0xFFFFFFFFu;
  sensor_msgs::Imu msg;
  msg.header = header("mav_imu_link", none);
  msg.linear_acceleration.z = 9.81;
  imu_.publish(msg);
  publishImage(none);
  EXPECT_TRUE(diagnostics_.await(dropped, before + 2));
  const ros::Time then = stamp_;
  EXPECT_TRUE(rest([&] { return status_.back().header.stamp > then; }, true)) << "it works on";
}

TEST_F(Inputs, ASilentNodeNamesTheTopicThatHasTheImages) {
  const ros::Publisher compressed =
      handle_.advertise<sensor_msgs::CompressedImage>("other/mav/camera/image_raw/compressed", 1);
  ros::Publisher raw = handle_.advertise<sensor_msgs::Image>("other/mav/camera/image_raw", 1);
  ASSERT_TRUE(spinUntil([&] { return raw.getNumSubscribers() > 0 && subscribers_[1].getNumPublishers() > 2; }));
  // The silence begins with one that the node has heard: what is not sent yet a shutdown drops.
  const ros_utils::NodeDiagnostics other("other/mav_vo");
  ASSERT_TRUE(spinUntil([&] {
    raw.publish(sensor_msgs::Image());
    return other.counted(raw.getTopic() + " messages") > 0;
  }));
  raw.shutdown();
  const std::string line =
      "nothing on /other/mav/camera/image_raw for 3 s: nobody publishes it (is a remapping or a namespace wrong?), but "
      "/other/mav/camera/image_raw/compressed is advertised: set the parameter image_transport, or the launch argument "
      "mav_image_transport, to compressed";
  EXPECT_TRUE(spinUntil([&] { return said("/other/mav_vo", line) > 0; }));
}

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "mav_vo_inputs_test");
  ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
