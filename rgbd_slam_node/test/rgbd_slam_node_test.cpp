// Drives rgbd_slam_node with a simulated robot: frames, one tf authority, finite numbers, bad input, a looped
// recording.
#include <air_ground/SaveMap.h>
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoStatus.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <cstdio>
#include <set>

#include "air_ground_common/mesh.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

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
    cloud_sub_ = handle_.subscribe<sensor_msgs::PointCloud2>(
        "ground/map_cloud", 20, [this](const sensor_msgs::PointCloud2::ConstPtr& m) { clouds.push_back(*m); });
    tf_sub_ = handle_.subscribe("/tf", 500, &NodeTest::onTf, this);
    geometry_msgs::TransformStamped camera, imu, depth_camera;
    depth_robot_.camera.width = 320;
    depth_robot_.camera.height = 240;
    depth_robot_.camera.cx = 159.5;
    depth_robot_.camera.cy = 119.5;
    depth_robot_.camera.fx = depth_robot_.camera.fy = 180;
    depth_robot_.mounting.T_base_camera.translation() += Eigen::Vector3d(0.05, -0.08, 0.03);
    camera.header.frame_id = imu.header.frame_id = "ground_base_link";
    camera.child_frame_id = "ground_camera_optical_frame";
    imu.child_frame_id = "ground_imu_link";
    depth_camera.header.frame_id = "ground_base_link";
    depth_camera.child_frame_id = kDepthFrame;
    depth_camera.transform = ros_utils::toTransformMsg(depth_robot_.mounting.T_base_camera);
    camera.transform = ros_utils::toTransformMsg(robot_.mounting.T_base_camera);
    imu.transform = ros_utils::toTransformMsg(Pose(*robot_.mounting.R_base_imu));
    broadcaster_.sendTransform(std::vector<geometry_msgs::TransformStamped>{camera, imu, depth_camera});
    ASSERT_TRUE(spinUntil([&] {
      return colour_.getNumSubscribers() > 0 && depth_.getNumSubscribers() > 0 && info_.getNumSubscribers() > 0 &&
             imu_.getNumSubscribers() > 0 && odometry_sub_.getNumPublishers() > 0 &&
             status_sub_.getNumPublishers() > 0 && cloud_sub_.getNumPublishers() > 0 && tf_sub_.getNumPublishers() > 0;
    })) << "the node did not start";
    pause(20);
    clouds.clear();  // what an earlier test left latched
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

TEST_F(NodeTest, TracksMapsSavesAndSurvivesALoop) {
  drive(40, true, {});
  ASSERT_TRUE(answered(40));
  EXPECT_GE(status.size(), 37u);
  ASSERT_GT(odometry.size(), 33u);
  for (const auto& m : odometry) {
    EXPECT_EQ(m.header.frame_id, "ground_map");
    EXPECT_EQ(m.child_frame_id, "ground_base_link");
    const Pose T = ros_utils::fromMsg(m.pose.pose), truth = robot_.mapped(m.header.stamp.toSec() - kStart);
    // The first frames' map is not levelled yet.
    EXPECT_LT((T.translation() - truth.translation()).norm(), 0.06) << m.header.stamp.toSec() - kStart;
    EXPECT_LT(air_ground_common::rotationAngle(T.linear(), truth.linear()), 0.05);
    for (int i = 0; i < 6; ++i) EXPECT_GT(m.pose.covariance[7 * i], 0);
  }
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING);
  EXPECT_GT(status.back().map_points, 50u);
  EXPECT_EQ(status.back().map_id % 10000, 1u);  // each start numbers its maps anew

  std::map<std::string, std::set<std::string>> parents;
  std::map<std::string, ros::Time> newest;
  for (const auto& t : tf) {
    parents[t.child_frame_id].insert(t.header.frame_id);
    EXPECT_GT(t.header.stamp, newest[t.child_frame_id]) << "a repeated or older stamp on " << t.child_frame_id;
    newest[t.child_frame_id] = t.header.stamp;
  }
  for (const char* child : {"ground_odom", "ground_base_link"}) EXPECT_EQ(authorities[child].size(), 1u) << child;
  EXPECT_EQ(parents["ground_odom"], std::set<std::string>{"ground_map"});
  EXPECT_EQ(parents["ground_base_link"], std::set<std::string>{"ground_odom"});

  // A cloud each second, and one of all keyframes when no more images come.
  ASSERT_TRUE(spinUntil([&] { return !clouds.empty() && clouds.back().header.stamp.toSec() > kStart + 2.5; }));
  EXPECT_EQ(clouds.back().header.frame_id, "ground_map");
  std::size_t dropped = 0;
  const auto points = ros_utils::cloudFromMsg(clouds.back(), &dropped);
  EXPECT_GT(points.size(), 3000u);
  EXPECT_EQ(dropped, 0u);
  double height = 0;
  for (const auto& p : points) height += p.position.z() / points.size();
  EXPECT_NEAR(height, 0, 0.02);

  air_ground::SaveMap map;
  map.request.path = "/tmp/rgbd_slam_node_test.ply";
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/save_map", map));
  EXPECT_TRUE(map.response.success) << map.response.message;
  EXPECT_EQ(air_ground_common::readPlyPoints(map.request.path).size(), map.response.points);
  std::remove(map.request.path.c_str());
  map.request.path = "/nowhere/at/all.ply";
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/save_map", map));
  EXPECT_FALSE(map.response.success);
  air_ground::SaveTrajectory trajectory;
  trajectory.request.path = "/tmp/rgbd_slam_node_test.txt";
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/save_trajectory", trajectory));
  EXPECT_TRUE(trajectory.response.success) << trajectory.response.message;
  EXPECT_EQ(air_ground_common::readTum(trajectory.request.path).size(), odometry.size());
  std::remove(trajectory.request.path.c_str());

  // The recording begins again: stamps jump back by four seconds.
  odometry.clear();
  status.clear();
  drive(15, false, {});
  ASSERT_TRUE(answered(15));
  EXPECT_GE(status.size(), 14u);  // a jump costs the first image
  ASSERT_GT(odometry.size(), 10u);
  EXPECT_LT(odometry.front().header.stamp.toSec(), kStart + 0.5);
  EXPECT_LT(ros_utils::fromMsg(odometry.front().pose.pose).translation().norm(), 0.02);
  EXPECT_EQ(status.back().map_id % 10000, 2u);

  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  EXPECT_TRUE(reset.response.success);
  // The latched cloud is of a map that is no more: an empty one takes its place, and none of the old map comes after
  // it.
  const auto emptied = [&] { return !clouds.empty() && clouds.back().width * clouds.back().height == 0; };
  EXPECT_TRUE(spinUntil(emptied));
  pause(300);
  EXPECT_TRUE(emptied());
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/save_trajectory", trajectory));
  EXPECT_FALSE(trajectory.response.success);
}

TEST_F(NodeTest, TakesUpAnImuThatStartsLate) {
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  Course course;
  course.imu_from = 2.0;
  drive(20, false, course);
  EXPECT_TRUE(spinUntil([&] { return diagnostics_.message().find("without IMU") != std::string::npos; }));
  course.first = 20;
  drive(40, false, course);
  ASSERT_TRUE(answered(40));
  ASSERT_FALSE(odometry.empty());
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING);
  std::uint32_t first_map = 0;
  for (const auto& s : status)
    if (first_map == 0 && s.state == air_ground::VoStatus::STATE_TRACKING) first_map = s.map_id;
  EXPECT_EQ(status.back().map_id, first_map + 1) << "a new map, once";
  // Only the IMU knows that the base is not level.
  const Eigen::Vector3d up = ros_utils::fromMsg(odometry.back().pose.pose).linear().row(2),
                        truth = robot_.mapped(odometry.back().header.stamp.toSec() - kStart).linear().row(2);
  EXPECT_LT((up - truth).norm(), 0.02);
}

TEST_F(NodeTest, NamesAWrongUnitOfDepthAndGoesOnWithTheRightOne) {
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  Course course;
  course.wrong_unit = true;
  drive(10, false, course);
  ASSERT_TRUE(spinUntil([&] {
    return !status.empty() && status.back().reason.find("wrong unit") != std::string::npos;
  })) << status.back().reason;
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_WAITING);
  EXPECT_TRUE(odometry.empty());
  course.first = 10;
  course.wrong_unit = false;
  drive(40, false, course);
  ASSERT_TRUE(answered(40));
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING) << status.back().reason;
}

// Receivers take a figure that changes for a correction of the map.
TEST_F(NodeTest, ARefusedFrameTellsTheMapsRevision) {
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  // Begun in motion, the map is levelled later.
  robot_.speed = 0.6;
  robot_.tilt = {0.1, -0.06, 0};
  robot_.accel_bias = {0.3, -0.3, 0.25};
  robot_.sway = 0.02;
  Course course;
  course.first = 20;
  drive(90, false, course);
  ASSERT_TRUE(answered(90));
  const std::uint32_t revision = status.back().map_revision;
  ASSERT_GT(revision, 0u);
  status.clear();
  course.first = 90;
  course.wrong_unit = true;
  drive(96, false, course);
  ASSERT_TRUE(answered(96));
  EXPECT_NE(status.back().reason.find("wrong unit"), std::string::npos) << status.back().reason;
  for (const auto& s : status) EXPECT_EQ(s.map_revision, revision);
}

TEST_F(NodeTest, DoubtsDepthOfAnotherFrameAndTakesIt) {
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  Course course;
  drive(10, false, course);
  ASSERT_TRUE(answered(10));
  const std::string doubt = "depth images of the colour images' size in another frame: taken for registered";
  EXPECT_EQ(diagnostics_.counted(doubt), 0);
  course.first = 10;
  course.other_frame = true;
  drive(20, false, course);
  ASSERT_TRUE(answered(20));
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING) << status.back().reason;
  EXPECT_TRUE(spinUntil([&] { return diagnostics_.counted(doubt) >= 10; }));

  const std::string calibration = "depth images whose calibration is not the colour camera's";
  EXPECT_EQ(diagnostics_.counted(calibration), 0);
  course.first = 20;
  course.other_frame = false;
  course.other_calibration = true;
  drive(30, false, course);
  ASSERT_TRUE(answered(30));
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING) << status.back().reason;
  EXPECT_TRUE(spinUntil([&] { return diagnostics_.counted(calibration) >= 8; }));
}

TEST_F(NodeTest, CarriesDepthFromItsOwnStamp) {
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  Course course;
  robot_.depth_delay = course.depth_after = 0.015;
  drive(40, false, course);
  ASSERT_TRUE(answered(40));
  ASSERT_TRUE(diagnostics_.refresh());
  EXPECT_GE(diagnostics_.counted("depth images carried to their colour image's time"), 20) << "since the reset";
  EXPECT_EQ(diagnostics_.counted("depth images after their colour images by [ms]"), 15);
}

TEST_F(NodeTest, NamesSwappedAxesOfTheImu) {
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  Course course;
  course.swapped_imu = true;
  drive(100, false, course);
  ASSERT_TRUE(spinUntil([&] { return diagnostics_.counted("gyro and images turn differently (correlation") > 0; }));
}

TEST_F(NodeTest, BeginsANewMapWithAnotherCalibration) {
  drive(20, false, {});
  ASSERT_TRUE(answered(20));
  ASSERT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING);
  const std::uint32_t before = status.back().map_id;
  odometry.clear();
  Course course;
  course.first = 20;
  course.cropped = true;
  ASSERT_TRUE(calibrate(1.95, course));
  drive(40, false, course);
  ASSERT_TRUE(answered(40));
  EXPECT_EQ(status.back().map_id, before + 1);
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING) << status.back().reason;
  EXPECT_GT(odometry.size(), 10u);
}

// With depth_registered: false, in a launch file of its own.
TEST_F(NodeTest, RegistersDepthItself) {
  ASSERT_TRUE(spinUntil([&] { return depth_info_.getNumSubscribers() > 0; }));
  drive(15, false, {});  // no calibration of the depth camera yet
  ASSERT_TRUE(answered(15));
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_WAITING);
  EXPECT_NE(status.back().reason.find("/ground/depth/camera_info"), std::string::npos) << status.back().reason;
  Course course;
  course.first = 15;
  course.unregistered = true;
  depth_info_.publish(ros_utils::toMsg(depth_robot_.camera, cameraHeader(1.45)));
  ASSERT_TRUE(diagnostics_.awaitReceived(depth_info_.getTopic(), cameraHeader(1.45).stamp));
  robot_.start = 1.5;
  drive(50, false, course);
  ASSERT_TRUE(answered(50));
  EXPECT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING) << status.back().reason;
  ASSERT_GT(odometry.size(), 20u);
  // Depth taken for registered would be off by up to 0.1 m, and so the landmarks.
  const Pose moved = ros_utils::fromMsg(odometry.back().pose.pose), truth = robot_.mapped(4.9);
  EXPECT_GT(truth.translation().norm(), 0.5);
  EXPECT_LT((moved.translation() - truth.translation()).norm(), 0.03);
}

}  // namespace
}  // namespace rgbd_slam

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "rgbd_slam_node_test");
  return RUN_ALL_TESTS();
}
