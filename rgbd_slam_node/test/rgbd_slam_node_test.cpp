// The running node: frames, one tf authority, finite numbers, bad input, a looped recording.
#include <air_ground/SaveMap.h>
#include <air_ground/SaveTrajectory.h>

#include <cstdio>

#include "air_ground_common/mesh.h"
#include "node_fixture.h"

namespace rgbd_slam {
namespace {

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
  // The first, the next, whose size nobody knew, and a correction: no more of them in 3.5 s at cloud_bandwidth.
  ASSERT_TRUE(spinUntil([&] { return !clouds.empty(); }));
  pause(200);
  EXPECT_LE(clouds.size(), 3u);
}

}  // namespace
}  // namespace rgbd_slam

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "rgbd_slam_node_test");
  return RUN_ALL_TESTS();
}
