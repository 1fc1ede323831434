// tf, odometry and path of a robot. Of the program of ros_helpers_test.cpp.
#include "air_ground_common/ros/pose_publisher.h"

#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"

namespace air_ground_common::ros_utils {
namespace {

/// What comes on /tf and of the publisher's odometry, from when both are connected on.
struct Listener {
  Listener() {
    ros::NodeHandle handle;
    tf_subscriber = handle.subscribe<tf2_msgs::TFMessage>(
        "/tf", 100, [this](const tf2_msgs::TFMessage::ConstPtr& m) { tf.push_back(*m); });
    odometry_subscriber = handle.subscribe<nav_msgs::Odometry>(
        "odometry", 100, [this](const nav_msgs::Odometry::ConstPtr& m) { odometry.push_back(*m); });
    EXPECT_TRUE(spinUntil(
        [this] { return tf_subscriber.getNumPublishers() > 0 && odometry_subscriber.getNumPublishers() > 0; }));
  }

  std::vector<tf2_msgs::TFMessage> tf;
  std::vector<nav_msgs::Odometry> odometry;
  ros::Subscriber tf_subscriber, odometry_subscriber;
};

TEST(PosePublisher, MapOdomBaseChainStaysWholeAndOdomDoesNotJump) {
  NodeHealth health("pose_publisher_test");
  PosePublisher publisher(ros::NodeHandle(), {"m", "o", "b", "odometry", "path"}, health);
  const Listener listener;
  const auto& tf = listener.tf;
  const auto& odometry = listener.odometry;
  const Pose step = yawPose(0.1, {0.5, 0, 0});
  const Matrix6d covariance = 0.01 * Matrix6d::Identity();
  Matrix6d noise = Matrix6d::Identity() * 1e-4;
  noise(0, 0) = 4e-4;
  EXPECT_TRUE(publisher.publish(ros::Time(1.0), Pose::Identity(), {}, covariance));
  EXPECT_TRUE(publisher.publish(ros::Time(1.5), step, {step, noise}, covariance));
  EXPECT_FALSE(publisher.publish(ros::Time(1.5), step, {step, noise}, covariance)) << "a stamp is never sent twice";
  // Loop closure moves the pose in the map by 1 m; the robot itself moved by one step.
  const Pose corrected = yawPose(0, {1, 0, 0}) * step * step;
  EXPECT_TRUE(publisher.publish(ros::Time(3.0), corrected, {step, std::nullopt}, covariance));
  ASSERT_TRUE(spinUntil([&] { return tf.size() >= 3 && odometry.size() >= 3; }));
  ASSERT_EQ(tf.size(), 3u);

  const Pose T_map_odom = fromMsg(tf[2].transforms[0].transform), T_odom_base = fromMsg(tf[2].transforms[1].transform);
  EXPECT_EQ(tf[2].transforms[0].header.frame_id, "m");
  EXPECT_EQ(tf[2].transforms[1].child_frame_id, "b");
  EXPECT_LT(((T_map_odom * T_odom_base).matrix() - corrected.matrix()).norm(), 1e-9);
  EXPECT_LT((T_odom_base.matrix() - (step * step).matrix()).norm(), 1e-9) << "odom jumped";
  EXPECT_LT((fromMsg(odometry[2].pose.pose).matrix() - corrected.matrix()).norm(), 1e-9);
  // 0.5 m ahead while turning left by 0.1 rad in half a second, seen by the base at the end of it.
  EXPECT_NEAR(odometry[1].twist.twist.linear.x, std::cos(0.1), 1e-9);
  EXPECT_NEAR(odometry[1].twist.twist.linear.y, -std::sin(0.1), 1e-9);
  EXPECT_NEAR(odometry[1].twist.twist.angular.z, 0.2, 1e-9);
  EXPECT_NEAR(odometry[1].twist.covariance[0],
              4 * (4e-4 * std::pow(std::cos(0.1), 2) + 1e-4 * std::pow(std::sin(0.1), 2)), 1e-9);
  EXPECT_NEAR(odometry[1].twist.covariance[35], 4e-4, 1e-9);
  EXPECT_EQ(odometry[0].twist.covariance[0], 1e6) << "not known";
  EXPECT_EQ(odometry[2].twist.covariance[0], 1e6) << "not known";
}

// Odometry of the robot on which a controller relies must not leap where SLAM begins afresh (REP 105).
TEST(PosePublisher, ANewMapMovesMapToOdomAlone) {
  NodeHealth health("pose_publisher_test");
  PosePublisher publisher(ros::NodeHandle(), {"m", "o", "b", "odometry", "path"}, health);
  const Listener listener;
  const Pose step = yawPose(0, {1, 0, 0}), travelled = yawPose(0, {5, 0, 0});
  const Matrix6d covariance = 0.01 * Matrix6d::Identity();
  double stamp = 1;
  Pose T_map_base = Pose::Identity();
  publisher.publish(ros::Time(stamp), T_map_base, {}, covariance);
  while (stamp < 6)
    publisher.publish(ros::Time(++stamp), T_map_base = T_map_base * step, {step, covariance}, covariance);

  publisher.beginMap();
  publisher.publish(ros::Time(20), Pose::Identity(), {step, covariance}, covariance);  // a motion of which none knows
  EXPECT_FALSE(publisher.publish(ros::Time(19), Pose::Identity(), {}, covariance)) << "time goes on";
  publisher.publish(ros::Time(21), step, {step, covariance}, covariance);
  publisher.reset();
  publisher.publish(ros::Time(2), step, {}, covariance);
  ASSERT_TRUE(spinUntil([&] { return listener.tf.size() >= 9 && listener.odometry.size() >= 9; }));
  const auto mapToOdom = [&](int i) { return fromMsg(listener.tf[i].transforms[0].transform); };
  const auto odomToBase = [&](int i) { return fromMsg(listener.tf[i].transforms[1].transform); };
  EXPECT_LT((odomToBase(5).matrix() - travelled.matrix()).norm(), 1e-9);
  EXPECT_LT((odomToBase(6).matrix() - travelled.matrix()).norm(), 1e-9) << "odom jumped with the map";
  EXPECT_LT(((mapToOdom(6) * odomToBase(6)).matrix() - Pose::Identity().matrix()).norm(), 1e-9);
  EXPECT_EQ(listener.odometry[6].twist.covariance[0], 1e6) << "not known";
  EXPECT_LT((odomToBase(7).matrix() - (travelled * step).matrix()).norm(), 1e-9) << "and goes on from there";
  EXPECT_LT(((mapToOdom(7) * odomToBase(7)).matrix() - step.matrix()).norm(), 1e-9);
  EXPECT_NEAR(listener.odometry[7].twist.twist.linear.x, 1, 1e-9);
  EXPECT_LT((odomToBase(8).matrix() - step.matrix()).norm(), 1e-9) << "after a jump of time nothing is kept";
}

/// A robot whose wheels say on tf where it is.
struct OdomFromTf : testing::Test {
  static PosePublisherSettings settings() {
    PosePublisherSettings settings{"map", "wheels", "robot", "odometry", "path"};
    settings.odom_from_tf = true;
    return settings;
  }

  NodeHealth health{"pose_publisher_test"};
  const NodeDiagnostics diagnostics{ros::this_node::getName().substr(1)};
  PosePublisher publisher{ros::NodeHandle(), settings(), health};
  const Listener listener;
  tf2_ros::TransformBroadcaster wheels;
  const Matrix6d covariance = 0.01 * Matrix6d::Identity();
};

TEST_F(OdomFromTf, FitsMapToOdomToTheOdometryOnTf) {
  const auto sendWheels = [&](double stamp, double yaw, double x) {
    geometry_msgs::TransformStamped msg;
    msg.header.stamp = ros::Time(stamp);
    msg.header.frame_id = "wheels";
    msg.child_frame_id = "robot";
    msg.transform = toTransformMsg(yawPose(yaw, {x, 0, 0}));
    wheels.sendTransform(msg);
  };
  const auto mapToOdom = [&] {
    std::vector<geometry_msgs::TransformStamped> edges;
    for (const auto& message : listener.tf)
      for (const auto& edge : message.transforms)
        if (edge.child_frame_id != "robot") edges.push_back(edge);
    return edges;
  };
  const Pose T_map_base = yawPose(0.5, {1, 2, 0});
  publisher.publish(ros::Time(100.5), T_map_base, {}, covariance);
  ASSERT_TRUE(spinUntil([&] { return listener.odometry.size() == 1; }));
  EXPECT_TRUE(mapToOdom().empty()) << "it waits for the wheels";
  sendWheels(100.4, 0, 3);
  ASSERT_TRUE(spinUntil([&] { return listener.tf.size() == 1; }));
  sendWheels(100.6, 0, 4);
  ASSERT_TRUE(spinUntil([&] { return !mapToOdom().empty(); }));
  const auto edge = mapToOdom().front();
  EXPECT_EQ(edge.header.frame_id, "map");
  EXPECT_EQ(edge.child_frame_id, "wheels");
  EXPECT_EQ(edge.header.stamp, ros::Time(100.5));
  EXPECT_LT((fromMsg(edge.transform).matrix() - (T_map_base * yawPose(0, {-3.5, 0, 0})).matrix()).norm(), 1e-9);

  for (double stamp = 101; stamp < 102.4; stamp += 0.6) publisher.publish(ros::Time(stamp), T_map_base, {}, covariance);
  EXPECT_TRUE(diagnostics.await("poses without 'wheels' -> 'robot' on tf at their stamp", 1));
  EXPECT_EQ(diagnostics.counted("poses without"), 1) << "the others may still be known";
  sendWheels(103, 0, 4);
  ASSERT_TRUE(spinUntil([&] { return mapToOdom().size() == 3; }));
  for (const auto& message : listener.tf)
    for (const auto& other : message.transforms)
      EXPECT_EQ(other.header.frame_id, other.child_frame_id == "robot" ? "wheels" : "map");
  // The clock of all runs back.
  publisher.reset();
  sendWheels(50.4, 0, 1);
  sendWheels(50.6, 0, 1);
  publisher.publish(ros::Time(50.5), T_map_base, {}, covariance);
  ASSERT_TRUE(spinUntil([&] { return mapToOdom().back().header.stamp == ros::Time(50.5); }));
}

// Odometry of wheels that divides by a time of 0, say; and edges that pass one by one.
TEST_F(OdomFromTf, TransformsThatAreNoneEndNothing) {
  const auto send = [&](double stamp, double x, double w) {
    const std::vector<std::string> frames{"wheels", "axle", "body", "robot"};
    std::vector<geometry_msgs::TransformStamped> chain(3);
    for (std::size_t i = 0; i < chain.size(); ++i) {
      chain[i].header.stamp = ros::Time(stamp);
      chain[i].header.frame_id = frames[i];
      chain[i].child_frame_id = frames[i + 1];
      chain[i].transform.rotation.z = chain[i].transform.rotation.w = w;
      chain[i].transform.translation.x = x;
    }
    wheels.sendTransform(chain);
  };
  const auto mapToOdom = [&] {
    for (const auto& message : listener.tf)
      for (const auto& edge : message.transforms)
        if (edge.child_frame_id == "wheels") return edge.header.stamp.toSec();
    return 0.0;
  };
  double stamp = 100;
  const auto publishUntil = [&](double x, double w, const std::function<bool()>& done) {
    return spinUntil([&] {
      publisher.publish(ros::Time(stamp += 0.1), Pose::Identity(), {}, covariance);
      send(stamp, x, w);
      return done();
    });
  };
  const std::string none = "poses without 'wheels' -> 'robot'";
  ASSERT_TRUE(publishUntil(INFINITY, std::sqrt(0.5), [&] { return diagnostics.counted(none) > 0; }));
  EXPECT_EQ(mapToOdom(), 0);
  const int before = diagnostics.counted(none);
  ASSERT_TRUE(publishUntil(0, 0.71, [&] { return diagnostics.counted(none) > before + 20; }));
  EXPECT_EQ(mapToOdom(), 0);
  EXPECT_TRUE(publishUntil(0, std::sqrt(0.5), [&] { return mapToOdom() > 0; })) << "right ones count";
}

TEST(BoundedPath, ThinsOutAndIsPublishedOnceASecond) {
  BoundedPath path("m", 0.1, 50);
  int published = 0;
  std::size_t longest = 0;
  geometry_msgs::PoseStamped pose;
  for (int i = 0; i < 10000; ++i) {  // 20 Hz, 1 m/s
    pose.header.stamp = ros::Time(100 + 0.05 * i);
    pose.pose.position.x = 0.05 * i;
    published += path.add(pose);
    longest = std::max(longest, path.message().poses.size());
  }
  EXPECT_LE(published, 501);
  EXPECT_GT(published, 50);
  EXPECT_EQ(longest, 50u);
  const auto& poses = path.message().poses;
  EXPECT_GT(poses.size(), 20u);
  EXPECT_EQ(poses.front().pose.position.x, 0);
  EXPECT_GT(poses.back().pose.position.x, 500 - 2 * 500.0 / 25);
  for (std::size_t i = 2; i < poses.size(); ++i) EXPECT_GT(poses[i].pose.position.x, poses[i - 1].pose.position.x);
  // Time that ran back, as in a looped bag, does not silence it.
  pose.header.stamp = ros::Time(100);
  pose.pose.position.x = 0;
  EXPECT_TRUE(path.add(pose));
  EXPECT_EQ(path.message().header.stamp, pose.header.stamp);
  EXPECT_FALSE(path.add(pose)) << "nothing new";
  path.clear();
  EXPECT_TRUE(path.message().poses.empty());
  EXPECT_TRUE(path.add(pose));
}

}  // namespace
}  // namespace air_ground_common::ros_utils
