// The node from outside: a rendered flight in, clouds and depth maps out.
#pragma once

#include <air_ground/PosedDepthMap.h>
#include <air_ground/PosedImage.h>
#include <gtest/gtest.h>
#include <nav_msgs/Path.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>

#include <set>
#include <vector>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "synthetic_scene.h"

namespace dense_fusion::testing {

namespace ros_utils = air_ground_common::ros_utils;

constexpr int kFrames = 30;
constexpr double kStep = 0.02;  // [m] between frames

class FlightTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    camera_ = new air_ground_common::CameraModel;
    camera_->width = 376;
    camera_->height = 240;
    camera_->fx = camera_->fy = 210;
    camera_->cx = 187.5;
    camera_->cy = 119.5;
    images_ = new std::vector<cv::Mat>;
    const auto scene = boxScene();
    for (int i = 0; i < kFrames; ++i) images_->push_back(scene.render(*camera_, pose(i), 1, 0));
  }

  static Eigen::Isometry3d pose(int i) { return lookDown({-0.3 + kStep * i, 0.05, 2}, 0.001 * i, 0.02, 0.3); }

  void SetUp() override {
    publisher_ = handle_.advertise<air_ground::PosedImage>("mav/posed_image", 100);
    ASSERT_TRUE(ros_utils::spinUntil([&] { return publisher_.getNumSubscribers() > 0; }));
    // Before anything subscribes: it would get what the node keeps of the test before.
    std_srvs::Trigger trigger;
    ASSERT_TRUE(ros_utils::callService("dense_fusion/reset", trigger));
    subscribe();
  }

  void subscribe() {
    cloud_subscriber_ = handle_.subscribe<sensor_msgs::PointCloud2>(
        "mav/dense_cloud", 100, [this](const sensor_msgs::PointCloud2::ConstPtr& m) { clouds_.push_back(m); });
    depth_subscriber_ = handle_.subscribe<air_ground::PosedDepthMap>(
        "mav/depth_map", 100, [this](const air_ground::PosedDepthMap::ConstPtr& m) { depth_maps_.push_back(m); });
    ASSERT_TRUE(ros_utils::spinUntil(
        [&] { return cloud_subscriber_.getNumPublishers() > 0 && depth_subscriber_.getNumPublishers() > 0; }));
  }

  // One image of the flight; the map frame may be shifted to tell maps apart.
  air_ground::PosedImage message(int i, double start, std::uint32_t map_id, double shift_x = 0,
                                 std::uint32_t map_revision = 0) {
    air_ground::PosedImage msg;
    msg.header.stamp.fromSec(start + 0.05 * i);
    msg.header.stamp.nsec += 7;  // stamps must come back exactly
    msg.header.frame_id = "mav_map";
    std_msgs::Header optical = msg.header;
    optical.frame_id = "mav_camera_optical_frame";
    if (i % 2 == 0)
      msg.image = ros_utils::toMsg((*images_)[i], "mono8", optical);
    else
      msg.compressed = ros_utils::compressed((*images_)[i], 90, optical);
    msg.camera_info = ros_utils::toMsg(*camera_, optical);
    Eigen::Isometry3d T = pose(i);
    T.translation().x() += shift_x;
    T.translation() *= size_;
    msg.pose.pose = ros_utils::toMsg(T);
    msg.depth_min = static_cast<float>(1.4 * size_);
    msg.depth_max = static_cast<float>(2.1 * size_);
    msg.metric = true;
    msg.map_id = map_id;
    msg.map_revision = map_revision;
    return msg;
  }

  void send(const air_ground::PosedImage& msg) {
    sent_.insert(msg.header.stamp);
    publisher_.publish(msg);
  }

  void fly(double start, std::uint32_t map_id, double shift_x = 0, std::uint32_t map_revision = 0) {
    for (int i = 0; i < kFrames; ++i) {
      send(message(i, start, map_id, shift_x, map_revision));
      ros_utils::pause(2);
    }
  }

  // Where the images flown from `start` are said to have been taken now: higher by `up` [m].
  nav_msgs::Path correctedPath(double start, double up) {
    nav_msgs::Path path;
    path.header = message(kFrames - 1, start, 1).header;
    for (int i = 0; i < kFrames; ++i) {
      const air_ground::PosedImage image = message(i, start, 1);
      path.poses.emplace_back().header.stamp = image.header.stamp;
      path.poses.back().pose = image.pose.pose;
      path.poses.back().pose.position.z += up;
    }
    return path;
  }

  // True when the node has taken the image in, and all before.
  bool taken(const air_ground::PosedImage& msg) {
    return diagnostics_.awaitReceived(publisher_.getTopic(), msg.header.stamp);
  }

  // Has the node fuse what was flown, the last time from `start`. The service answers when the worker is done; then
  // everything published is on its way.
  void flush(double start) {
    ASSERT_TRUE(taken(message(kFrames - 1, start, 1)));
    std_srvs::Trigger trigger;
    ASSERT_TRUE(ros_utils::callService("dense_fusion/flush", trigger));
    ASSERT_TRUE(trigger.response.success) << trigger.response.message;
    ros_utils::pause(20);
  }

  // The same, and waits for the cloud and the depth map of the flight.
  void flushToCloud(double start) {
    const std::size_t before = clouds_.size();
    flush(start);
    ASSERT_TRUE(ros_utils::spinUntil([&] { return clouds_.size() > before && depth_maps_.size() == clouds_.size(); }));
  }

  inline static air_ground_common::CameraModel* camera_ = nullptr;
  inline static std::vector<cv::Mat>* images_ = nullptr;
  ros::NodeHandle handle_;
  ros::Publisher publisher_;
  ros::Subscriber cloud_subscriber_, depth_subscriber_;
  ros_utils::NodeDiagnostics diagnostics_{"dense_fusion"};
  std::vector<sensor_msgs::PointCloud2::ConstPtr> clouds_;
  std::vector<air_ground::PosedDepthMap::ConstPtr> depth_maps_;
  std::set<ros::Time> sent_;
  double size_ = 1;  // of the world
};

}  // namespace dense_fusion::testing
