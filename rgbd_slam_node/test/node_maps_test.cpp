// What becomes of the running node's maps: on disk when they end, and with those who subscribe late.
#include <air_ground/MapKeyframes.h>
#include <air_ground/SaveTrajectory.h>

#include <cstdlib>
#include <filesystem>
#include <tuple>

#include "air_ground_common/mesh.h"
#include "node_fixture.h"

namespace rgbd_slam {
namespace {

namespace fs = std::filesystem;

/// The files in the node's folder autosave whose names end so.
std::vector<std::string> saved(const std::string& end) {
  std::vector<std::string> paths;
  for (const auto& entry : fs::directory_iterator(std::string(std::getenv("ROS_HOME")) + "/maps")) {
    const std::string path = entry.path();
    if (path.size() > end.size() && path.compare(path.size() - end.size(), end.size(), end) == 0) paths.push_back(path);
  }
  return paths;
}

struct Maps : NodeTest {
  void SetUp() override {
    NodeTest::SetUp();
    std_srvs::Trigger reset;
    ASSERT_TRUE(ros_utils::callService("rgbd_slam/reset", reset));
  }

  ros::Subscriber hearKeyframes(std::vector<air_ground::MapKeyframes>* keyframes) {
    return handle_.subscribe<air_ground::MapKeyframes>(
        "ground/map_keyframes", 10,
        [keyframes](const air_ground::MapKeyframes::ConstPtr& m) { keyframes->push_back(*m); });
  }
};

TEST_F(Maps, ThoseThatEndAreSaved) {
  drive(25, false, {});
  ASSERT_TRUE(answered(25));
  const std::uint32_t first = status.back().map_id;
  // Lost among unknown places.
  robot_.texture = simulated::synthetic::texture(1800, 8);
  robot_.texture.convertTo(robot_.texture, -1, 1.8, -102);
  Course course;
  course.first = 25;
  drive(110, false, course);
  ASSERT_TRUE(answered(110));
  ASSERT_EQ(status.back().state, air_ground::VoStatus::STATE_TRACKING) << status.back().reason;
  const std::uint32_t second = status.back().map_id;
  ASSERT_EQ(second, first + 1);
  // Another calibration.
  course.first = 110;
  course.cropped = true;
  ASSERT_TRUE(calibrate(10.95, course));
  drive(125, false, course);
  ASSERT_TRUE(answered(125));
  ASSERT_EQ(status.back().map_id, second + 1);

  air_ground::SaveTrajectory trajectory;
  const std::string path = testing::TempDir() + "rgbd_slam_node_test_ended";
  trajectory.request.path = path + ".txt";
  ASSERT_TRUE(ros_utils::callService("rgbd_slam/save_trajectory", trajectory));
  EXPECT_TRUE(trajectory.response.success) << trajectory.response.message;
  EXPECT_GE(air_ground_common::readTum(path + ".txt").front().stamp, kStart + 10.9);
  const auto name = [](std::uint32_t id) { return "map" + std::to_string(id); };
  for (const auto& [id, begin, end] : {std::tuple{first, 0.0, 2.5}, std::tuple{second, 7.0, 11.0}}) {
    const std::string written = path + "_" + name(id) + ".txt";
    EXPECT_NE(trajectory.response.message.find(written), std::string::npos) << trajectory.response.message;
    const auto poses = air_ground_common::readTum(written);
    ASSERT_GT(poses.size(), 18u);
    EXPECT_GE(poses.front().stamp, kStart + begin);
    EXPECT_LT(poses.back().stamp, kStart + end);
    const std::string cloud_name = "_" + name(id) + ".ply", trajectory_name = "_trajectory_" + name(id) + ".txt";
    ASSERT_TRUE(spinUntil([&] { return saved(cloud_name).size() == 1; }));
    EXPECT_GT(air_ground_common::readPlyPoints(saved(cloud_name).front()).size(), 3000u);
    ASSERT_EQ(saved(trajectory_name).size(), 1u);
    EXPECT_EQ(air_ground_common::readTum(saved(trajectory_name).front()).size(), poses.size());
    std::remove(written.c_str());
  }
  std::remove((path + ".txt").c_str());
}

// A head that pans as the map begins: its cloud goes out when poses do.
TEST_F(Maps, OneThatBeginsWhilePosesAreWithheldIsPublished) {
  Course course;
  course.wrong_unit = true;  // the mounting is read, and no map begins
  drive(5, false, course);
  ASSERT_TRUE(answered(5));
  Pose panned = robot_.mounting.T_base_camera;
  panned.translation().x() += 0.05;
  mountCamera(panned);
  pause(200);
  course.wrong_unit = false;
  course.first = 5;
  drive(10, false, course);
  ASSERT_TRUE(spinUntil([&] { return status.back().header.stamp == cameraHeader(0.9).stamp; }));
  ASSERT_NE(status.back().reason.find("has moved"), std::string::npos) << status.back().reason;
  ASSERT_TRUE(odometry.empty());
  mountCamera(robot_.mounting.T_base_camera);
  pause(200);
  course.first = 10;
  drive(30, false, course);
  ASSERT_TRUE(answered(30));
  EXPECT_FALSE(odometry.empty());
  EXPECT_TRUE(spinUntil([&] { return !clouds.empty() && clouds.back().width > 3000; }));
}

TEST_F(Maps, WhoComesLateToARobotThatStandsGetsItOnce) {
  robot_.rest = 100;
  drive(15, false, {});
  ASSERT_TRUE(answered(15));
  ASSERT_TRUE(spinUntil([&] { return !clouds.empty() && clouds.back().width > 0; }));
  clouds.erase(clouds.begin(), clouds.end() - 1);  // empty: the map before has ended
  Course course;
  course.first = 15;
  for (const int until : {30, 45}) {  // it is started again
    std::vector<air_ground::MapKeyframes> keyframes;
    const ros::Subscriber late = hearKeyframes(&keyframes);
    ASSERT_TRUE(spinUntil([&] { return !keyframes.empty(); })) << "no images come";
    drive(until, false, course);
    ASSERT_TRUE(answered(until));
    course.first = until;
    EXPECT_EQ(keyframes.size(), 1u);
    EXPECT_EQ(keyframes.front().map_id, status.back().map_id);
    EXPECT_GT(keyframes.front().ids.size(), 0u);
    EXPECT_EQ(keyframes.front().features.size(), keyframes.front().ids.size());
  }
  std::vector<air_ground::MapKeyframes> keyframes;
  const ros::Subscriber late = hearKeyframes(&keyframes);
  drive(75, false, course);
  EXPECT_FALSE(keyframes.empty()) << "images come";

  EXPECT_EQ(clouds.size(), 1u) << "it has not changed";
  cloud_sub_.shutdown();
  hearClouds();
  ASSERT_TRUE(spinUntil([&] { return clouds.size() > 1; })) << "but is kept for who comes late";
  EXPECT_EQ(clouds[1].data, clouds[0].data);
}

}  // namespace
}  // namespace rgbd_slam
