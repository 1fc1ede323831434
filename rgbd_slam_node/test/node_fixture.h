// Drives rgbd_slam_node with a simulated robot, and keeps what it publishes.
#pragma once

#include <air_ground/VoStatus.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <map>
#include <set>
#include <string>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "simulated_robot.h"

namespace rgbd_slam {

namespace ros_utils = air_ground_common::ros_utils;
using ros_utils::pause;
using ros_utils::spinUntil;
constexpr double kStart = 1000.0;

class NodeTest : public testing::Test {
 protected:
  void SetUp() override {
    colour_ = handle_.advertise<sensor_msgs::Image>("ground/rgb/image_raw", 100);
    depth_ = handle_.advertise<sensor_msgs::Image>("ground/depth/image_raw", 100);
    info_ = handle_.advertise<sensor_msgs::CameraInfo>("ground/rgb/camera_info", 100);
    depth_info_ = handle_.advertise<sensor_msgs::CameraInfo>("ground/depth/camera_info", 100);
    imu_ = handle_.advertise<sensor_msgs::Imu>("ground/imu/data", 1000);
    odometry_sub_ = handle_.subscribe<nav_msgs::Odometry>(
        "ground/odometry", 200, [this](const nav_msgs::Odometry::ConstPtr& m) { odometry.push_back(*m); });
    status_sub_ = handle_.subscribe<air_ground::VoStatus>(
        "ground/slam_status", 200, [this](const air_ground::VoStatus::ConstPtr& m) { status.push_back(*m); });
    hearClouds();
    tf_sub_ = handle_.subscribe("/tf", 500, &NodeTest::onTf, this);
    geometry_msgs::TransformStamped imu, depth_camera;
    depth_robot_.camera.width = 320;
    depth_robot_.camera.height = 240;
    depth_robot_.camera.cx = 159.5;
    depth_robot_.camera.cy = 119.5;
    depth_robot_.camera.fx = depth_robot_.camera.fy = 180;
    depth_robot_.mounting.T_base_camera.translation() += Eigen::Vector3d(0.05, -0.08, 0.03);
    imu.header.frame_id = "ground_base_link";
    imu.child_frame_id = "ground_imu_link";
    depth_camera.header.frame_id = "ground_base_link";
    depth_camera.child_frame_id = kDepthFrame;
    depth_camera.transform = ros_utils::toTransformMsg(depth_robot_.mounting.T_base_camera);
    imu.transform = ros_utils::toTransformMsg(Pose(*robot_.mounting.R_base_imu));
    broadcaster_.sendTransform(std::vector<geometry_msgs::TransformStamped>{imu, depth_camera});
    mountCamera(robot_.mounting.T_base_camera);
    ASSERT_TRUE(spinUntil([&] {
      return colour_.getNumSubscribers() > 0 && depth_.getNumSubscribers() > 0 && info_.getNumSubscribers() > 0 &&
             imu_.getNumSubscribers() > 0 && odometry_sub_.getNumPublishers() > 0 &&
             status_sub_.getNumPublishers() > 0 && cloud_sub_.getNumPublishers() > 0 && tf_sub_.getNumPublishers() > 0;
    })) << "the node did not start";
    pause(20);
    clouds.clear();  // what an earlier test left latched
  }

  /// What tf says of it from now on.
  void mountCamera(const Pose& T_base_camera) {
    geometry_msgs::TransformStamped camera;
    camera.header.frame_id = "ground_base_link";
    camera.child_frame_id = "ground_camera_optical_frame";
    camera.transform = ros_utils::toTransformMsg(T_base_camera);
    broadcaster_.sendTransform(camera);
  }

  void hearClouds() {
    cloud_sub_ = handle_.subscribe<sensor_msgs::PointCloud2>(
        "ground/map_cloud", 20, [this](const sensor_msgs::PointCloud2::ConstPtr& m) { clouds.push_back(*m); });
  }

  void onTf(const ros::MessageEvent<tf2_msgs::TFMessage const>& event) {
    for (const auto& t : event.getMessage()->transforms) {
      authorities[t.child_frame_id].insert(event.getPublisherName());
      tf.push_back(t);
    }
  }

  struct Course {
    int first = 0;                   ///< frame
    double imu_from = 0;             ///< the IMU's first sample [s]
    bool cropped = false;            ///< images and calibration of the middle only
    bool wrong_unit = false;         ///< depth in millimetres where metres are due
    bool swapped_imu = false;        ///< x, y, z come as z, y, -x
    bool other_calibration = false;  ///< on depth's camera_info, though depth is registered
    bool unregistered = false;       ///< depth as a camera of its own sees it, 0.1 m beside the colour camera
    bool other_frame = false;        ///< depth says that it is of the depth camera's frame
    double depth_after = 0.003;      ///< stamp of depth less that of its image [s]
  };

  static constexpr int kMarginX = 40, kMarginY = 30;  ///< of the image's cropped middle [px]

  static std_msgs::Header cameraHeader(double t) {
    std_msgs::Header header;
    header.stamp = ros::Time(kStart + t);
    header.frame_id = "ground_camera_optical_frame";
    return header;
  }

  CameraModel cameraOf(const Course& course) const {
    CameraModel camera = robot_.camera;
    if (course.cropped) {
      camera.width -= 2 * kMarginX;
      camera.height -= 2 * kMarginY;
      camera.cx -= kMarginX;
      camera.cy -= kMarginY;
    }
    return camera;
  }

  /// Publishes the course's calibration; true when the node has it.
  bool calibrate(double t, const Course& course) {
    info_.publish(ros_utils::toMsg(cameraOf(course), cameraHeader(t)));
    return diagnostics_.awaitReceived(info_.getTopic(), cameraHeader(t).stamp);
  }

  /// Publishes frames up to `frames` at 10 Hz of the robot's time; `spoil` mixes in what must not hurt.
  void drive(int frames, bool spoil, const Course& course) {
    simulated::synthetic::Random random(3);
    double next_imu = std::max(course.imu_from, 0.1 * course.first);
    for (int i = course.first; i < frames; ++i) {
      const double t = 0.1 * i;
      for (; next_imu <= t + 0.005; next_imu += 0.005) {
        const auto s = robot_.imu(next_imu, random);
        sensor_msgs::Imu msg;
        msg.header.stamp = ros::Time(kStart + next_imu);
        msg.header.frame_id = "ground_imu_link";
        const auto set = [](geometry_msgs::Vector3& to, const Eigen::Vector3d& from) {
          to.x = from.x();
          to.y = from.y();
          to.z = from.z();
        };
        set(msg.angular_velocity, s.angular_velocity);
        set(msg.linear_acceleration, s.specific_force);
        if (spoil && next_imu > 1 && next_imu < 1.02) msg.angular_velocity.x = NAN;
        if (course.swapped_imu) {
          for (auto* v : {&msg.angular_velocity, &msg.linear_acceleration}) {
            std::swap(v->x, v->z);
            v->z = -v->z;
          }
        }
        imu_.publish(msg);
      }
      auto frame = robot_.frame(t, random);
      if (course.unregistered) frame.depth = depth_robot_.frame(t, random).depth;
      const CameraModel camera = cameraOf(course);
      if (course.cropped) {
        const cv::Rect middle(kMarginX, kMarginY, camera.width, camera.height);
        frame.gray = frame.gray(middle).clone();
        frame.depth = frame.depth(middle).clone();
      }
      std_msgs::Header header = cameraHeader(t);
      info_.publish(ros_utils::toMsg(camera, header));
      cv::Mat millimetres(frame.depth.size(), CV_16U, cv::Scalar(0));
      for (int v = 0; v < frame.depth.rows; ++v) {
        for (int u = 0; u < frame.depth.cols; ++u) {
          const float z = frame.depth.at<float>(v, u);
          if (std::isfinite(z)) millimetres.at<std::uint16_t>(v, u) = static_cast<std::uint16_t>(std::lround(1000 * z));
        }
      }
      auto colour = ros_utils::toMsg(frame.gray, "mono8", header);
      if (spoil && i == 12) {  // an image of another size and one that comes twice
        auto small = ros_utils::toMsg(cv::Mat(10, 10, CV_8UC1, cv::Scalar(0)), "mono8", header);
        colour_.publish(small);
      }
      colour_.publish(colour);
      if (spoil && i == 14) colour_.publish(colour);
      header.stamp += ros::Duration(course.depth_after);
      if (course.unregistered) {
        header.frame_id = kDepthFrame;
        depth_info_.publish(ros_utils::toMsg(depth_robot_.camera, header));
      }
      if (course.other_calibration) {
        auto other = robot_.camera;
        other.fx *= 0.8;
        other.fy *= 0.8;
        depth_info_.publish(ros_utils::toMsg(other, header));
      }
      if (course.other_frame) header.frame_id = kDepthFrame;
      if (course.wrong_unit)
        depth_.publish(ros_utils::toMsg(1000 * frame.depth, "32FC1", header));
      else if (!(spoil && i == 9))
        depth_.publish(ros_utils::toMsg(millimetres, "16UC1", header));
      pause(6);
    }
  }

  /// True when the node has answered to the last frame of a drive with odometry and tf, too, if it tracks.
  bool answered(int frames) {
    const ros::Time last = cameraHeader(0.1 * (frames - 1)).stamp;
    const auto ended = [&](const auto& messages) { return !messages.empty() && messages.back().header.stamp == last; };
    return spinUntil([&] {
      return ended(status) &&
             (status.back().state != air_ground::VoStatus::STATE_TRACKING || (ended(odometry) && ended(tf)));
    });
  }

  static constexpr const char* kDepthFrame = "ground_depth_optical_frame";
  simulated::Robot robot_, depth_robot_;
  ros::NodeHandle handle_;
  ros::Publisher colour_, depth_, info_, depth_info_, imu_;
  ros::Subscriber odometry_sub_, status_sub_, cloud_sub_, tf_sub_;
  ros_utils::NodeDiagnostics diagnostics_{"rgbd_slam"};
  tf2_ros::StaticTransformBroadcaster broadcaster_;
  std::vector<nav_msgs::Odometry> odometry;
  std::vector<air_ground::VoStatus> status;
  std::vector<sensor_msgs::PointCloud2> clouds;
  std::vector<geometry_msgs::TransformStamped> tf;
  std::map<std::string, std::set<std::string>> authorities;
};

}  // namespace rgbd_slam
