// What the tests of the node share: a vehicle on its way, its messages, and what the node answers.
#pragma once

#include <air_ground/SaveTrajectory.h>
#include <air_ground/StreetviewMatch.h>
#include <air_ground/TrackerInnovation.h>
#include <air_ground/VoIncrement.h>
#include <diagnostic_msgs/DiagnosticStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <nav_msgs/Path.h>
#include <ros/ros.h>
#include <sensor_msgs/FluidPressure.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/MagneticField.h>
#include <sensor_msgs/NavSatFix.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <random>

#include "air_ground_common/geodesy.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/trajectory.h"

namespace ekf_tracker::test {

using air_ground_common::Pose;
using air_ground_common::wrapAngle;
using air_ground_common::yawOf;
namespace ru = air_ground_common::ros_utils;
using ru::callService;
using ru::pause;
using ru::spinUntil;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kStart = 1000, kStep = 0.05;
inline const Pose kWorldMap = air_ground_common::yawPose(2.0, {120, -40, 6});

// A tilted vehicle on a weaving way.
inline Pose mapPose(int i) {
  const double t = i * kStep;
  Pose T =
      air_ground_common::yawPose(0.4 * std::sin(0.3 * t), {1.5 * t, 2 * std::sin(0.4 * t), 0.5 * std::sin(0.2 * t)});
  T.linear() = T.linear() * Eigen::AngleAxisd(0.15, Eigen::Vector3d::UnitY()).toRotationMatrix();
  return T;
}

inline ros::Time timeOf(int i) { return ros::Time(kStart + i * kStep); }

class EkfTrackerNodeTest : public ::testing::Test {
 protected:
  void SetUp() override {
    increments_ = handle_.advertise<air_ground::VoIncrement>("mav/vo_increment", 400);
    vo_ = handle_.advertise<nav_msgs::Odometry>("mav/odometry", 400);
    fixes_ = handle_.advertise<geometry_msgs::PoseWithCovarianceStamped>("streetview/pose", 100);
    magnetometer_ = handle_.advertise<sensor_msgs::MagneticField>("mav/imu/mag", 100);
    gps_ = handle_.advertise<sensor_msgs::NavSatFix>("gps/fix", 100);
    barometer_ = handle_.advertise<sensor_msgs::FluidPressure>("barometer", 100);
    odometry_sub_ = handle_.subscribe<nav_msgs::Odometry>(
        "tracked/odometry", 1000, [this](const nav_msgs::Odometry::ConstPtr& m) { tracked_.push_back(*m); });
    innovation_sub_ = handle_.subscribe<air_ground::TrackerInnovation>(
        "tracked/innovation", 1000,
        [this](const air_ground::TrackerInnovation::ConstPtr& m) { innovations_.push_back(*m); });
    geodetic_sub_ = handle_.subscribe<sensor_msgs::NavSatFix>(
        "tracked/geodetic", 1000, [this](const sensor_msgs::NavSatFix::ConstPtr& m) { geodetic_ = *m; });
    path_sub_ = handle_.subscribe<nav_msgs::Path>("tracked/path", 1000,
                                                  [this](const nav_msgs::Path::ConstPtr& m) { paths_.push_back(*m); });
    tf_sub_ = handle_.subscribe<tf2_msgs::TFMessage>("/tf", 1000, [this](const tf2_msgs::TFMessage::ConstPtr& m) {
      for (const auto& t : m->transforms)
        if (t.child_frame_id == "mav_map") edges_.push_back(t);
    });
    ASSERT_TRUE(reset());
    ASSERT_TRUE(spinUntil([&] {
      return increments_.getNumSubscribers() && vo_.getNumSubscribers() && fixes_.getNumSubscribers() &&
             magnetometer_.getNumSubscribers() && gps_.getNumSubscribers() && barometer_.getNumSubscribers() &&
             odometry_sub_.getNumPublishers() && innovation_sub_.getNumPublishers() && tf_sub_.getNumPublishers() &&
             geodetic_sub_.getNumPublishers() && path_sub_.getNumPublishers();
    }));
    pause(20);
    paths_.clear();  // what an earlier test left latched
  }

  static air_ground::VoIncrement increment(int from, int to) {
    air_ground::VoIncrement m;
    m.header.stamp = timeOf(to);
    m.previous_stamp = timeOf(from);
    m.relative_pose = ru::toMsg(Pose(mapPose(from).inverse() * mapPose(to)));
    for (std::size_t k = 0; k < 4; ++k) m.covariance[5 * k] = k < 3 ? 1e-4 : 1e-6;
    m.metric = true;
    return m;
  }

  void fly(int from, int to, const std::string& map_frame = "mav_map",
           const std::string& base_frame = "mav_base_link") {
    for (int i = from; i < to; ++i) {
      nav_msgs::Odometry vo;
      vo.header.stamp = timeOf(i + 1);
      vo.header.frame_id = map_frame;
      vo.child_frame_id = base_frame;
      vo.pose.pose = ru::toMsg(mapPose(i + 1));
      // Either topic may come first.
      if (i % 2) vo_.publish(vo);
      increments_.publish(increment(i, i + 1));
      if (i % 2 == 0) vo_.publish(vo);
      if (i % 40 == 39) pause(4);
    }
  }

  static geometry_msgs::PoseWithCovarianceStamped fix(int i, const Eigen::Vector3d& error = Eigen::Vector3d::Zero()) {
    geometry_msgs::PoseWithCovarianceStamped m;
    m.header.stamp = timeOf(i);
    m.header.frame_id = "world";
    Pose T = kWorldMap * mapPose(i);
    T.translation() += error;
    m.pose.pose = ru::toMsg(T);
    for (std::size_t k = 0; k < 6; ++k) m.pose.covariance[7 * k] = k < 3 ? 1.0 : 0.01;
    return m;
  }

  int answered() const {
    int n = 0;
    for (const auto& m : innovations_) n += m.source == air_ground::TrackerInnovation::SOURCE_FIX && !m.revised;
    return n;
  }

  // Publishes true fixes; true when each has had its effect.
  bool giveFixes(const std::vector<int>& at) {
    const int before = answered();
    for (int i : at) fixes_.publish(fix(i));
    return spinUntil([&] { return answered() == before + static_cast<int>(at.size()); });
  }

  static sensor_msgs::FluidPressure pressure(int i) {
    sensor_msgs::FluidPressure m;
    m.header.stamp = timeOf(i);
    m.fluid_pressure =
        101325 * std::pow(1 - 0.0065 * (420 + (kWorldMap * mapPose(i)).translation().z()) / 288.15, 5.255876);
    return m;
  }

  static sensor_msgs::NavSatFix gps(int i, const Eigen::Vector3d& error = Eigen::Vector3d::Zero()) {
    static const air_ground_common::LocalFrame frame("EPSG:2056", {2683300, 1247900, 420});
    const auto g = frame.toGeodetic((kWorldMap * mapPose(i)).translation() + error);
    sensor_msgs::NavSatFix m;
    m.header.stamp = timeOf(i);
    m.latitude = g.latitude, m.longitude = g.longitude, m.altitude = g.height + 47.3;
    m.status.status = sensor_msgs::NavSatStatus::STATUS_FIX;
    return m;
  }

  // True when the node's odometry has come so far, be it located or not: a barometer reading (at most one a second)
  // waits for it.
  bool reach(int i) {
    barometer_.publish(pressure(i));
    return spinUntil([&] {
      for (const auto& m : innovations_)
        if (m.source == air_ground::TrackerInnovation::SOURCE_BAROMETER && m.header.stamp == timeOf(i)) return true;
      return false;
    });
  }

  bool awaitStamp(int i) {
    return spinUntil(
        [&] { return !tracked_.empty() && tracked_.back().header.stamp >= timeOf(i) - ros::Duration(1e-4); });
  }

  static bool reset() {
    std_srvs::Trigger reset;
    return callService("ekf_tracker/reset", reset) && reset.response.success;
  }

  /// Saved before the node forgot them, with poses in them.
  static std::size_t keptTrajectories() {
    std::size_t kept = 0;
    const std::string folder = ros::param::param<std::string>("/ekf_tracker/autosave", "");
    for (const auto& file : std::filesystem::directory_iterator(folder))
      kept += file.path().filename().string().find("_trajectory_") != std::string::npos &&
              !air_ground_common::readTum(file.path().string()).empty();
    return kept;
  }

  int results(int result) const {
    int n = 0;
    for (const auto& m : innovations_) n += m.source == air_ground::TrackerInnovation::SOURCE_FIX && m.result == result;
    return n;
  }

  void expectFinite() const {
    for (const auto& m : tracked_) {
      const Pose T = ru::fromMsg(m.pose.pose);  // throws unless finite and of unit length
      const auto covariance = ru::covarianceFromMsg(m.pose.covariance);
      EXPECT_GT(Eigen::LLT<air_ground_common::Matrix6d>(covariance).matrixL().toDenseMatrix().diagonal().minCoeff(), 0);
      EXPECT_EQ(covariance, covariance.transpose());
      EXPECT_LT(T.translation().norm(), 1e4);
    }
  }

  void expectOnTheWay(int i, double metres) {
    ASSERT_TRUE(awaitStamp(i));
    const Pose estimate = ru::fromMsg(tracked_.back().pose.pose), truth = kWorldMap * mapPose(i);
    EXPECT_LT((estimate.translation() - truth.translation()).norm(), metres);
    EXPECT_LT(air_ground_common::rotationAngle(estimate.linear(), truth.linear()), 0.05);
  }

  ros::NodeHandle handle_;
  ros::Publisher increments_, vo_, fixes_, magnetometer_, gps_, barometer_;
  ros::Subscriber odometry_sub_, innovation_sub_, geodetic_sub_, path_sub_, tf_sub_;
  std::vector<nav_msgs::Odometry> tracked_;
  std::vector<air_ground::TrackerInnovation> innovations_;
  std::vector<geometry_msgs::TransformStamped> edges_;
  sensor_msgs::NavSatFix geodetic_;
  std::vector<nav_msgs::Path> paths_;
  const ru::NodeDiagnostics diagnostics_{"ekf_tracker"};
};

}  // namespace ekf_tracker::test
