// The helpers that need a master: parameters, health, mountings. Started by ros_helpers.test.
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include "air_ground_common/ros/calibration_report.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/mountings.h"
#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/ros/parameters.h"
#include "air_ground_common/ros/robot_map_input.h"
#include "air_ground_common/ros/sensor_input.h"
#include "console.h"

namespace air_ground_common::ros_utils {
namespace {

std::string errorOf(const std::function<void()>& call) {
  try {
    call();
  } catch (const ParameterError& e) {
    return e.what();
  }
  return "";
}

TEST(Parameters, OutOfRangeNamesParameterValueAndRange) {
  ros::NodeHandle pnh("~range");
  pnh.setParam("voxel", 7.0);
  ServerReader parameters(pnh);
  double voxel = 0.02;
  const std::string error = errorOf([&] { parameters("voxel", voxel, {0.001, 1}, "m", ""); });
  EXPECT_NE(error.find("range/voxel = 7.0 must lie in [0.001, 1] m"), std::string::npos) << error;
}

TEST(Parameters, WrongTypeChoiceAndSizeAreRefused) {
  ros::NodeHandle pnh("~types");
  pnh.setParam("count", "many");
  pnh.setParam("mode", "fast");
  pnh.setParam("origin", std::vector<double>{1, 2});
  ServerReader parameters(pnh);
  int count = 1, mode = 0;
  std::vector<double> origin{0, 0, 0};
  EXPECT_NE(errorOf([&] { parameters("count", count, {0, 9}, "", ""); }).find("count"), std::string::npos);
  EXPECT_NE(errorOf([&] {
              parameters.choice("mode", mode, {{"slow", 0}, {"slower", 1}}, "");
            }).find("slower"),
            std::string::npos);
  EXPECT_NE(errorOf([&] { parameters("origin", origin, {-9, 9}, "m", ""); }).find("3"), std::string::npos);
}

TEST(Parameters, MisspeltNameIsFoundAndIntegerReadsAsNumber) {
  ros::NodeHandle pnh("~names");
  pnh.setParam("sigma", 2);
  pnh.setParam("sgima", 3);
  ServerReader parameters(pnh);
  double sigma = 1;
  parameters("sigma", sigma, {0, 5}, "", "");
  EXPECT_DOUBLE_EQ(sigma, 2.0);
  EXPECT_NE(errorOf([&] { parameters.finish(); }).find("sgima"), std::string::npos);
  parameters.others("sgima");
  EXPECT_EQ(errorOf([&] { parameters.finish(); }), "");
}

TEST(Parameters, ThePeriodOfDiagnosticsIsKnownToEveryNode) {
  ros::NodeHandle pnh("~standard");
  pnh.setParam("diagnostic_period", 0.2);
  EXPECT_EQ(errorOf([&] { ServerReader(pnh).finish(); }), "");
  pnh.setParam("diagnostic_period", 0);
  EXPECT_NE(errorOf([&] { ServerReader(pnh).finish(); }).find("diagnostic_period"), std::string::npos);
}

TEST(NodeHealth, ReportsAsOftenAsItsParameterSays) {
  std::vector<double> stamps;
  const auto diagnostics = ros::NodeHandle().subscribe<diagnostic_msgs::DiagnosticArray>(
      "/diagnostics", 100, [&](const diagnostic_msgs::DiagnosticArray::ConstPtr& m) {
        if (m->status.front().hardware_id == "period_test") stamps.push_back(m->header.stamp.toSec());
      });
  ros::NodeHandle("~").setParam("diagnostic_period", 0.1);
  const NodeHealth health("period_test");
  EXPECT_TRUE(spinUntil([&] { return stamps.size() > 11; }));
  ros::NodeHandle("~").deleteParam("diagnostic_period");
  ASSERT_GT(stamps.size(), 11u);
  std::vector<double> gaps;
  for (std::size_t i = 2; i < stamps.size(); ++i) gaps.push_back(stamps[i] - stamps[i - 1]);
  std::nth_element(gaps.begin(), gaps.begin() + 5, gaps.end());
  EXPECT_LT(gaps[5], 0.5);
}

TEST(NodeHealth, AnInputThatDiesIsAnError) {
  NodeHealth health("silence_test");
  NodeDiagnostics diagnostics(ros::this_node::getName().substr(1));
  const std::string silent = "nothing on /camera/image_raw";
  const auto says = [&](const std::string& line) { return diagnostics.message().find(line) != std::string::npos; };
  const auto alive = [&] {
    return spinUntil([&] {
      health.received("/camera/image_raw", ros::Time::now());  // again and again: 3 s may pass between two turns
      return says("tracking") && !says(silent);
    });
  };
  health.expectInput("/camera/image_raw");
  health.state(health.kOk, "tracking");
  EXPECT_TRUE(alive());
  EXPECT_EQ(diagnostics.level(), diagnostic_msgs::DiagnosticStatus::OK);
  EXPECT_TRUE(spinUntil([&] { return says(silent); }));
  EXPECT_EQ(diagnostics.level(), diagnostic_msgs::DiagnosticStatus::ERROR);
  EXPECT_TRUE(alive()) << "and recovers";
  EXPECT_EQ(diagnostics.level(), diagnostic_msgs::DiagnosticStatus::OK);
}

TEST(StreamGate, StartsAfreshAtAJumpAndCountsWhatItDrops) {
  NodeHealth health("gate_test");
  int afresh = 0;
  StreamGate gate(2, health, [&] { ++afresh; });
  EXPECT_TRUE(gate.admit(0, ros::Time(110.0)));
  EXPECT_TRUE(gate.admit(1, ros::Time(110.0)));
  EXPECT_EQ(afresh, 0);
  EXPECT_TRUE(gate.admit(0, ros::Time(100.0))) << "the first message of the new pass";
  EXPECT_EQ(afresh, 1);
  EXPECT_FALSE(gate.admit(1, ros::Time(109.0))) << "the end of the old one";
  EXPECT_EQ(health.counted("messages of the time before a jump dropped"), 1u);
  EXPECT_TRUE(gate.admit(1, ros::Time(100.1)));
  EXPECT_EQ(afresh, 1);
  for (int i = 1; i <= 20; ++i) EXPECT_TRUE(gate.admit(0, ros::Time(100 + 0.05 * i)));
  EXPECT_FALSE(gate.admit(0, ros::Time()));
  EXPECT_EQ(health.counted("messages whose stamp was not set dropped"), 1u);
  EXPECT_FALSE(gate.admit(0, ros::Time(106.0))) << "after a gap";
  EXPECT_TRUE(gate.admit(0, ros::Time(106.05)));
  EXPECT_EQ(health.counted("messages far from those before in time dropped (one a gap is: the next confirms it)"), 1u);
  EXPECT_EQ(health.counted("messages of the time before a jump dropped"), 1u);
  EXPECT_EQ(afresh, 1);
}

TEST(NodeHealth, CountersReachDiagnostics) {
  NodeDiagnostics diagnostics(ros::this_node::getName().substr(1));
  NodeHealth health("test");
  health.count("broken images", 2);
  health.count("broken images");
  EXPECT_EQ(health.counted("broken images"), 3u);
  EXPECT_TRUE(diagnostics.await("broken images", 3));
  EXPECT_EQ(diagnostics.counted("broken images"), 3);
}

geometry_msgs::TransformStamped edge(const std::string& parent, const std::string& child, const Pose& T) {
  geometry_msgs::TransformStamped msg;
  msg.header.stamp = ros::Time(100);
  msg.header.frame_id = parent;
  msg.child_frame_id = child;
  msg.transform = toTransformMsg(T);
  return msg;
}

/// Publishes the edges in messages of their own that are not latched, as `rosbag play` does with all but the last.
void publishOnce(const std::string& topic, const std::vector<geometry_msgs::TransformStamped>& edges) {
  ros::Publisher publisher = ros::NodeHandle().advertise<tf2_msgs::TFMessage>(topic, 10);
  ASSERT_TRUE(spinUntil([&] { return publisher.getNumSubscribers() > 0; }));
  for (const auto& transform : edges) {
    tf2_msgs::TFMessage message;
    message.transforms.push_back(transform);
    publisher.publish(message);
  }
  pause(20);
}

TEST(Mountings, TwoMessagesThatAreNotLatchedAreKept) {
  const Mountings mountings("robot");
  const Pose T_robot_mast = yawPose(0.3, {1, 2, 3}), T_mast_camera = yawPose(0.2, {0, 0, 1}),
             T_robot_imu = yawPose(-0.1, {0.1, 0, 0});
  publishOnce("/tf_static", {edge("robot", "mast", T_robot_mast), edge("mast", "eye", T_mast_camera)});
  publishOnce("/tf_static", {edge("robot", "imu", T_robot_imu)});
  std::string why;
  std::optional<Pose> camera, imu;
  ASSERT_TRUE(spinUntil([&] {
    camera = mountings.lookup(std::nullopt, "eye", "camera", &why);
    imu = mountings.lookup(std::nullopt, "imu", "imu", &why);
    return camera && imu;
  }));
  EXPECT_LT((camera->matrix() - (T_robot_mast * T_mast_camera).matrix()).norm(), 1e-9);
  EXPECT_LT((imu->matrix() - T_robot_imu.matrix()).norm(), 1e-9);
}

TEST(Mountings, TransformsOnTfCountToo) {
  const Mountings mountings("rover");
  publishOnce("/tf", {edge("rover", "rover_camera", yawPose(0.5, {0, 1, 0}))});
  std::string why;
  EXPECT_TRUE(spinUntil([&] { return mountings.lookup(std::nullopt, "rover_camera", "camera", &why).has_value(); }));
}

TEST(Mountings, ATransformWithoutTimeIsLeftOut) {
  const Mountings mountings("crawler");
  const Pose T_crawler_camera = yawPose(0.5, {0, 1, 0});
  auto none = edge("crawler", "crawler_camera", Pose::Identity());
  none.header.stamp.sec = none.header.stamp.nsec = 0xFFFFFFFFu;
  publishOnce("/tf", {none, edge("crawler", "crawler_camera", T_crawler_camera)});
  std::string why;
  std::optional<Pose> camera;
  ASSERT_TRUE(spinUntil([&] {
    camera = mountings.lookup(std::nullopt, "crawler_camera", "camera", &why);
    return camera.has_value();
  }));
  EXPECT_LT((camera->matrix() - T_crawler_camera.matrix()).norm(), 1e-9);
}

TEST(Mountings, LeadingSlashesDoNotMatter) {
  const Mountings mountings("/kinect");
  publishOnce("/tf", {edge("/kinect", "/kinect_eye", yawPose(0.5, {0, 1, 0}))});
  std::string why;
  EXPECT_TRUE(spinUntil([&] { return mountings.lookup(std::nullopt, "/kinect_eye", "camera", &why).has_value(); }));
  EXPECT_TRUE(mountings.lookup(std::nullopt, "kinect", "imu", &why));
}

TEST(Mountings, SayWhatIsMissingAndWhatToDoAndNeverWait) {
  const Mountings mountings("base_link");
  std::string why;
  const ros::WallTime begin = ros::WallTime::now();
  EXPECT_FALSE(mountings.lookup(std::nullopt, "lens", "camera", &why));
  EXPECT_LT((ros::WallTime::now() - begin).toSec(), 1.0);
  for (const char* part : {"'base_link' <- 'lens'", "nothing has come on /tf_static or /tf", "base_camera"})
    EXPECT_NE(why.find(part), std::string::npos) << why;
  publishOnce("/tf_static", {edge("base", "lens", Pose::Identity())});
  EXPECT_TRUE(spinUntil([&] {
    return !mountings.lookup(std::nullopt, "lens", "camera", &why) &&
           why.find("knows the frames 'base', 'lens'") != std::string::npos;
  })) << why;
  EXPECT_FALSE(mountings.lookup(std::nullopt, "", "imu", &why));
  EXPECT_NE(why.find("imu_frame"), std::string::npos) << why;
  EXPECT_TRUE(mountings.lookup(std::nullopt, "base_link", "imu", &why));
  const Pose given = yawPose(0.3, {1, 2, 3});
  EXPECT_LT((mountings.lookup(given, "anywhere", "imu", &why)->matrix() - given.matrix()).norm(), 1e-12);
}

TEST(NodeHealth, SaysOnceWhyNothingIsPublished) {
  const Console console;
  NodeHealth health("withheld_test");
  int images = 0;
  const auto refuse = [&](const std::string& said, double seconds) {
    const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(seconds);
    return spinUntil([&] {
             ++images;
             health.withheld(std::to_string(images) + " of 90 landmarks agree, scale 0." + std::to_string(images),
                             "wait");
             return console.count(said) > 0 || ros::WallTime::now() > end;
           }) &&
           console.count(said) > 0;
  };
  const std::string reason = "of 90 landmarks agree";
  EXPECT_FALSE(refuse(reason, 2.0)) << "that may be normal";
  EXPECT_TRUE(refuse(reason, 30.0));
  EXPECT_EQ(console.count("What to do: wait"), 1);
  EXPECT_FALSE(refuse("no such line", 3.0));
  EXPECT_EQ(console.count(reason), 1) << "other numbers are no other reason";
  const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(30);
  EXPECT_TRUE(spinUntil([&] {
    health.withheld("no calibration");
    return console.count("no calibration") > 0 || ros::WallTime::now() > end;
  }));
  EXPECT_EQ(console.count("no calibration"), 1);
  health.published();
  pause(300);
  EXPECT_EQ(console.count("images come, but no pose"), 2) << "poses come, or no images";
}

TEST(CalibrationReport, SaysOnceThatTheImagesCorrectTheCalibration) {
  const Console console;
  NodeHealth health("calibration_test");
  CalibrationReport report(health, "left camera");
  report.setGiven(-0.2);
  for (const double k1 : {-0.2, -0.2003, -0.18, -0.1804, -0.2}) report.update(k1);
  EXPECT_TRUE(spinUntil([&] { return console.count("the left camera is off: k1 is -0.1800, not -0.2000") > 0; }));
  pause(300);
  EXPECT_EQ(console.count("left camera"), 1) << "no trifles; after a reset what was given holds again";
}

TEST(MountingReport, SaysWhichRotationWouldBeRight) {
  const Console console;
  NodeHealth health("mounting_test");
  MountingReport report(health, "drone");
  using air_ground_common::expSO3;
  report.setGiven(expSO3(Eigen::Vector3d(0, 0, M_PI / 2)));
  const Eigen::Matrix3d turn = expSO3(Eigen::Vector3d(0.05, 0, 0));
  const Eigen::Matrix3d none = Eigen::Matrix3d::Identity(), other = expSO3(Eigen::Vector3d(0, 0.02, 0));
  report.update(0, none);
  report.update(20, other);
  report.update(26, none);  // it had wandered
  report.update(40, turn);
  report.update(49, turn);
  pause(300);
  EXPECT_EQ(console.count("turned against each other"), 0);
  report.update(51, turn);
  // q(z, 90 degrees) q(x, 0.05): (sin(0.025), sin(0.025), cos(0.025), cos(0.025)) / sqrt(2)
  EXPECT_TRUE(spinUntil([&] {
    return console.count("by 2.9 degrees") && console.count("in drone is qx qy qz qw = 0.0177 0.0177 0.7069 0.7069");
  }));
  report.update(52, none);
  report.update(63, none);
  pause(300);
  EXPECT_EQ(console.count("turned against each other"), 1) << "after a reset what was given holds again";
}

// A replay's nodes wait for the player, which opens a large bag first.
TEST(NodeHealth, NothingIsSilentBeforeTheClockRuns) {
  ros::Time::setNow(ros::Time(5.0));
  const Console console;
  const ros::Publisher publisher = ros::NodeHandle().advertise<nav_msgs::Odometry>("/of_the_player", 1);
  NodeHealth health("paused_test");
  const ros::Publisher mapper = ros::NodeHandle().advertise<nav_msgs::Odometry>("/of_a_mapper", 1);
  health.expectInput("/of_the_player");
  health.expectInput("/of_nobody");
  health.expectInput("/of_a_mapper", false);
  EXPECT_TRUE(spinUntil([&] { return console.count("nothing on /of_nobody") > 0; }));
  pause(300);
  EXPECT_EQ(console.count("nothing on /of_the_player"), 0);
  double t = 5.0;
  EXPECT_TRUE(spinUntil([&] {
    ros::Time::setNow(ros::Time(t += 0.01));
    return console.count("nothing on /of_the_player for 3 s: it is advertised") > 0;
  }));
  EXPECT_EQ(console.count("nothing on /of_a_mapper"), 0) << "that takes longer";
  ros::Time::init();
}

TEST(RobotMapInput, TheFirstMapIsNoWarning) {
  constexpr int kWarn = rosgraph_msgs::Log::WARN;
  const Console console;
  NodeHealth health("maps_test");
  int forgotten = 0;
  RobotMapInput robot("ground robot", 1, RobotMapSession("ground_map"), health, [&] { ++forgotten; });
  for (const std::uint32_t id : {0, 1, 1}) robot.observe(id, ros::Time(10), false);
  EXPECT_TRUE(spinUntil([&] { return console.count("the ground robot has begun its first map (1)") > 0; }));
  EXPECT_EQ(forgotten, 1);
  robot.observe(2, ros::Time(20), false);
  EXPECT_TRUE(spinUntil([&] { return console.count("the ground robot has begun map 2", kWarn) > 0; }));
  EXPECT_EQ(console.count("first map", kWarn), 0);
  EXPECT_EQ(health.counted("new maps of the ground robot"), 1u);

  RobotMapInput mapped("ground robot", 1, RobotMapSession("ground_map"), health, [] {});
  mapped.observe(0, ros::Time(10), false);
  std_msgs::Header header;
  header.stamp = ros::Time(11);
  header.frame_id = "ground_map";
  EXPECT_TRUE(mapped.admitMap(0, header, "ground clouds"));
  mapped.observe(10001, ros::Time(20), false);  // started again, with a map at hand
  EXPECT_TRUE(spinUntil([&] { return console.count("the ground robot has begun map 10001", kWarn) > 0; }));
}

// As a live node finds it on a master of its own where a replay was run before.
TEST(NodeHealth, SaysThatNothingGivesTheClock) {
  ros::Time::setNow(ros::Time());
  const Console console;
  NodeHealth health("clock_test");
  health.expectInput("/of_a_camera");
  EXPECT_TRUE(spinUntil(
      [&] {
        health.received("/of_a_camera", ros::Time(1.5e9));
        return console.count("/use_sim_time is set, but nothing gives /clock: rosparam set /use_sim_time false") > 0;
      },
      2000));
  pause(300);
  EXPECT_EQ(console.count("nothing gives /clock"), 1);
  ros::Time::init();
}

TEST(NodeHealth, KindsOfReasonsAndCounters) {
  EXPECT_EQ(kindOf("14 of 105 tracks fit"), kindOf("9 of 88 tracks fit"));
  EXPECT_EQ(kindOf("missed by -0.25 s, 1e-05 allowed"), kindOf("missed by 3.5 s, 2.5 allowed"));
  EXPECT_NE(kindOf("nothing on /camera1/image"), kindOf("nothing on /camera2/image"));
  EXPECT_NE(kindOf("lost"), kindOf("waiting"));
  EXPECT_EQ(kindOf("ends in 3."), "ends in #.");
  NodeHealth health("kinds_test");
  for (int i = 0; i < 1000; ++i) health.count("image of " + std::to_string(i) + " rows");
  EXPECT_EQ(health.counted("image of 7 rows"), 1000u);
  for (int i = 0; i < 1000; ++i) health.count("frame a" + std::to_string(i));
  EXPECT_EQ(health.counted("frame a3"), 1u);
  EXPECT_EQ(health.counted("frame a999"), 0u) << "bounded";
  EXPECT_GT(health.counted("events of further kinds"), 800u);
}

TEST(Calibration, CountsAsNewOnlyWithAnImageOfItsSize) {
  Calibration in_use;
  in_use.info.header.frame_id = "camera";
  in_use.info.width = 640;
  in_use.info.height = 480;
  in_use.camera.width = 640;
  in_use.camera.height = 480;
  Calibration latest = in_use;
  sensor_msgs::Image image;
  image.header.frame_id = "optical";
  image.width = 640;
  image.height = 480;
  EXPECT_FALSE(recalibrated(in_use, latest, image));
  latest.info.roi.width = latest.camera.width = 320;  // the left half of the sensor
  latest.camera.height = 480;
  EXPECT_FALSE(recalibrated(in_use, latest, image)) << "an image of the old size";
  image.width = 320;
  EXPECT_TRUE(recalibrated(in_use, latest, image));

  EXPECT_EQ(cameraFrame("mine", latest, image), "mine");
  EXPECT_EQ(cameraFrame("", latest, image), "camera");
  latest.info.header.frame_id.clear();
  EXPECT_EQ(cameraFrame("", latest, image), "optical");
}

}  // namespace
}  // namespace air_ground_common::ros_utils

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "ros_helpers_test");
  const ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
