// The running node and its topics. The test owns /clock: outputs of an earlier test, or of before an event, are told by
// their stamps.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <air_ground/SaveMap.h>
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <rosgraph_msgs/Clock.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>

#include <cstdio>
#include <optional>
#include <set>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/mesh.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/node_testing.h"
#include "synthetic_scene.h"

namespace icp_refine {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;

/// Remembers the stamp of what was sent last.
struct CloudPublisher {
  void publish(const sensor_msgs::PointCloud2& msg) {
    last_stamp = msg.header.stamp;
    publisher.publish(msg);
  }
  ros::Publisher publisher;
  std::optional<ros::Time> last_stamp;
};

class NodeTest : public testing::Test {
 protected:
  NodeTest() {
    clock_ = handle_.advertise<rosgraph_msgs::Clock>("/clock", 10);
    coarse_ = handle_.advertise<AlignmentEstimate>("alignment/coarse", 10);
    aerial_.publisher = handle_.advertise<sensor_msgs::PointCloud2>("mav/dense_cloud", 50);
    ground_.publisher = handle_.advertise<sensor_msgs::PointCloud2>(
        "ground/map_cloud", 10, [this](const ros::SingleSubscriberPublisher&) { ++ground_connections_; }, {}, {}, true);
    status_ = handle_.advertise<air_ground::VoStatus>("mav/vo_status", 10);
    ground_status_ = handle_.advertise<air_ground::VoStatus>("ground/slam_status", 10);
    odometry_ = handle_.advertise<nav_msgs::Odometry>("mav/odometry", 10);
    guess_ = handle_.advertise<geometry_msgs::PoseWithCovarianceStamped>("initialpose", 10);
    corrections_ = handle_.advertise<air_ground::CloudCorrections>("mav/cloud_corrections", 10);
    refined_sub_ = handle_.subscribe("alignment/refined", 100, &NodeTest::onRefined, this);
    map_sub_ = handle_.subscribe("augmented_map", 10, &NodeTest::onMap, this);
    pose_sub_ = handle_.subscribe("mav/pose_in_ground_map", 100, &NodeTest::onPose, this);
    tf_sub_ = handle_.subscribe("/tf", 1000, &NodeTest::onTf, this);
  }

  void SetUp() override {
    ASSERT_TRUE(waitFor([this] {
      return clock_.getNumSubscribers() > 0 && coarse_.getNumSubscribers() > 0 &&
             aerial_.publisher.getNumSubscribers() > 0 && ground_.publisher.getNumSubscribers() > 0 &&
             guess_.getNumSubscribers() > 0 && status_.getNumSubscribers() > 0 &&
             ground_status_.getNumSubscribers() > 0 && odometry_.getNumSubscribers() > 0 &&
             corrections_.getNumSubscribers() > 0 && refined_sub_.getNumPublishers() > 0 &&
             pose_sub_.getNumPublishers() > 0 && map_sub_.getNumPublishers() > 0 && tf_sub_.getNumPublishers() > 0;
    }));
    // Every test starts with an empty node and later than the one before.
    static double start = 100;
    start_ = now_ = start += 1000;
    tick();
    resets_ = 0;
    std_srvs::Trigger reset;
    ASSERT_TRUE(ros_utils::callService("/icp_refine/reset", reset));
    EXPECT_TRUE(reset.response.success);
    ASSERT_TRUE(waitFor([this] { return resets_ > 0; }));
    pause(10);
    estimates_.clear();
    maps_.clear();
    transforms_.clear();
    poses_.clear();
  }

  // The looped bag goes back by 500 s.
  bool ofThisTest(const ros::Time& stamp) const { return stamp.toSec() > start_ - 505; }
  void onRefined(const AlignmentEstimate& msg) {
    resets_ += msg.reason == "reset";
    if (ofThisTest(msg.header.stamp)) estimates_.push_back(msg);
  }
  void onMap(const sensor_msgs::PointCloud2& msg) {
    if (ofThisTest(msg.header.stamp)) maps_.push_back(msg);
  }
  void onPose(const geometry_msgs::PoseWithCovarianceStamped& msg) {
    if (ofThisTest(msg.header.stamp)) poses_.push_back(msg);
  }
  void onTf(const tf2_msgs::TFMessage& msg) {
    for (const auto& t : msg.transforms)
      if (ofThisTest(t.header.stamp)) transforms_.push_back(t);
  }

  void tick(double dt = 0.05) {
    rosgraph_msgs::Clock msg;
    msg.clock = ros::Time(now_ += dt);
    clock_.publish(msg);
  }

  // Runs the clock at about real time while it waits, for so many turns of 20 ms.
  template <class Condition>
  bool waitFor(const Condition& condition, int turns = ros_utils::patience()) {
    for (int i = 0; i < turns; ++i) {
      tick(0.02);
      ros::spinOnce();
      if (condition()) return true;
      ros::WallDuration(0.02).sleep();
    }
    return false;
  }

  void pause(int turns) {
    waitFor([] { return false; }, turns);
  }

  bool waitForStatus(std::uint8_t status) {
    return waitFor([&] { return !estimates_.empty() && estimates_.back().status == status; });
  }

  std::string lastReason() const { return estimates_.empty() ? "no estimate came" : estimates_.back().reason; }

  bool isTaken(const CloudPublisher& clouds) const {
    return !clouds.last_stamp || diagnostics_.received(clouds.publisher.getTopic(), *clouds.last_stamp);
  }

  // True when the node has handled what was published before this: clouds, which are large, by what it says of them.
  // After the first answer all that has been read; in that time what its other connections held has been read, too.
  bool settle() {
    if (!waitFor([this] { return isTaken(ground_) && isTaken(aerial_); })) return false;
    for (int i = 0; i < 2; ++i) {
      pause(2);
      const std::size_t before = estimates_.size();
      std_srvs::Trigger refine;
      if (!ros_utils::callService("/icp_refine/refine", refine) || !waitFor([&] { return estimates_.size() > before; }))
        return false;
    }
    return true;
  }

  // True when the node's latest diagnostics are of now.
  bool refresh() {
    const ros::Time now(now_);
    return waitFor([&] { return diagnostics_.stamp() > now && diagnostics_.stamp().toSec() <= now_; });
  }

  // So often the node has counted the event by now.
  int countedNow(const std::string& event) {
    EXPECT_TRUE(refresh());
    return diagnostics_.counted(event);
  }

  bool awaitCount(const std::string& event, int times) {
    return waitFor([&] { return diagnostics_.counted(event) >= times; });
  }

  // True when no transform later than this comes for a while.
  bool noTransformAfter(double stamp) {
    pause(25);
    for (const auto& t : transforms_)
      if (t.header.stamp.toSec() > stamp && t.header.stamp.toSec() <= now_) return false;
    return true;
  }

  sensor_msgs::PointCloud2 cloud(const Cloud& cloud, const std::string& frame) {
    std::vector<ros_utils::CloudPoint> points;
    for (const auto& p : cloud.points) points.push_back({p, {90, 90, 90}, 0});
    std_msgs::Header header;
    header.stamp = ros::Time(now_);
    header.frame_id = frame;
    return ros_utils::toMsg(
        points, frame != "ground_map" ? ros_utils::CloudFields::kXyzIntensity : ros_utils::CloudFields::kXyzRgb,
        header);
  }

  /// Not only published but taken, so that what comes after meets it and not the map that a test before has left
  /// latched; what the node still says of that one comes before.
  void sendGround(const Cloud& ground) {
    ground_.publish(cloud(ground, "ground_map"));
    ASSERT_TRUE(settle());
  }

  void sendScene(const synthetic::Scene& scene) {
    ASSERT_NO_FATAL_FAILURE(sendGround(scene.ground));
    aerial_.publish(cloud(scene.aerial, "mav_map"));
  }

  void sendCoarse(const Pose& T, std::uint8_t status = AlignmentEstimate::STATUS_CONVERGED, std::uint32_t map_id = 0) {
    AlignmentEstimate msg;
    msg.header.stamp = ros::Time(now_);
    msg.header.frame_id = "ground_map";
    msg.child_frame_id = "mav_map";
    msg.pose.pose = ros_utils::toMsg(T);
    msg.status = status;
    msg.map_id = map_id;
    coarse_.publish(msg);
  }

  std::size_t aerialPoints(const sensor_msgs::PointCloud2& map) const {
    std::size_t count = 0;
    for (const auto& p : ros_utils::cloudFromMsg(map)) count += p.source == 1;
    return count;
  }
  bool anyAerialPoint() const {
    for (const auto& map : maps_) {
      if (map.width > 0 && aerialPoints(map) > 0) return true;
    }
    return false;
  }

  void sendOdometry(const Pose& T_mav_map_base, double covariance = 0) {
    nav_msgs::Odometry msg;
    msg.header.stamp = ros::Time(now_);
    msg.header.frame_id = "mav_map";
    msg.child_frame_id = "mav_base_link";
    msg.pose.pose = ros_utils::toMsg(T_mav_map_base);
    msg.pose.covariance.fill(covariance);
    odometry_.publish(msg);
  }

  void sendGroundStatus(std::uint32_t map_id, std::uint32_t map_revision = 0) {
    air_ground::VoStatus msg;
    msg.header.stamp = ros::Time(now_);
    msg.map_id = map_id;
    msg.map_revision = map_revision;
    ground_status_.publish(msg);
  }

  void sendStatus(std::uint32_t map_id, std::uint32_t map_revision = 0) {
    air_ground::VoStatus msg;
    msg.header.stamp = ros::Time(now_);
    msg.state = air_ground::VoStatus::STATE_TRACKING;
    msg.map_id = map_id;
    msg.map_revision = map_revision;
    status_.publish(msg);
  }

  void sendCorrections(const air_ground_common::CloudCorrections& corrections, std::uint32_t map_id) {
    std_msgs::Header header;
    header.stamp = ros::Time(now_);
    header.frame_id = "mav_map";
    corrections_.publish(ros_utils::toMsg(corrections, header, map_id));
  }

  Pose offset(const synthetic::Scene& scene) {
    std::mt19937 rng(4);
    return synthetic::perturbed(scene.T_ground_map_mav_map, synthetic::centroid(scene.aerial), 0.12, 0.05, true, rng);
  }

  // Position error at the middle of the aerial map [m].
  double error(const AlignmentEstimate& estimate, const synthetic::Scene& scene) {
    const Eigen::Vector3d c = synthetic::centroid(scene.aerial);
    return (similarity(ros_utils::fromMsg(estimate.pose.pose), estimate.scale) * c - scene.truth * c).norm();
  }

  // What tf said last.
  Pose lastTransform() const {
    geometry_msgs::Pose pose;
    pose.position.x = transforms_.back().transform.translation.x;
    pose.position.y = transforms_.back().transform.translation.y;
    pose.position.z = transforms_.back().transform.translation.z;
    pose.orientation = transforms_.back().transform.rotation;
    return ros_utils::fromMsg(pose);
  }

  ros::NodeHandle handle_;
  CloudPublisher aerial_, ground_;
  ros::Publisher clock_, coarse_, status_, ground_status_, odometry_, guess_, corrections_;
  ros::Subscriber refined_sub_, map_sub_, pose_sub_, tf_sub_;
  ros_utils::NodeDiagnostics diagnostics_{"icp_refine"};
  std::vector<AlignmentEstimate> estimates_;
  std::vector<sensor_msgs::PointCloud2> maps_;
  std::vector<geometry_msgs::PoseWithCovarianceStamped> poses_;
  std::vector<geometry_msgs::TransformStamped> transforms_;
  double now_ = 0, start_ = 0;
  int ground_connections_ = 0, resets_ = 0;
};

}  // namespace icp_refine
