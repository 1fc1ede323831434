// The running node and its topics. Outputs of an earlier test are told by their stamps.
#pragma once

#include <air_ground/AlignmentEstimate.h>
#include <air_ground/HeightMap.h>
#include <air_ground/VoStatus.h>
#include <geometry_msgs/PoseArray.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <gtest/gtest.h>
#include <nav_msgs/OccupancyGrid.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>

#include <atomic>
#include <cmath>
#include <functional>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "synthetic_world.h"

namespace ros_utils = air_ground_common::ros_utils;
namespace syn = heightmap_mcl::synthetic;
using air_ground::AlignmentEstimate;
using air_ground_common::Pose;
using ros_utils::pause;
using ros_utils::spinUntil;

namespace heightmap_mcl_testing {

constexpr double kTestsApart = 5000;  // [s], their stamps

template <typename T>
struct Inbox {
  std::vector<T> messages;
  ros::Subscriber subscriber;
  /// Messages stamped before `begin` are of an earlier test; those without a stamp are of the empty node.
  void connect(ros::NodeHandle& node, const std::string& topic, const ros::Time& begin = ros::Time()) {
    subscriber = node.subscribe<T>(topic, 100, [this, begin](const boost::shared_ptr<const T>& m) {
      const ros::Time stamp = stampOf(*m);
      if (stamp.isZero() || stamp > begin) messages.push_back(*m);
    });
  }
  static ros::Time stampOf(const tf2_msgs::TFMessage&) { return ros::Time(); }
  template <typename M>
  static ros::Time stampOf(const M& m) {
    return m.header.stamp;
  }
};

class NodeTest : public ::testing::Test {
 protected:
  explicit NodeTest(const std::string& name_space = "")
      : node_(name_space), diagnostics_(name_space.empty() ? "heightmap_mcl" : name_space + "/heightmap_mcl") {}

  void SetUp() override {
    stamp_ = ros::Time(10000.0 + kTestsApart * ++test_number_);
    const ros::Time begin = stamp_ - ros::Duration(kTestsApart / 2);
    cloud_ = node_.advertise<sensor_msgs::PointCloud2>("mav/dense_cloud", 20);
    ground_ = node_.advertise<sensor_msgs::PointCloud2>("ground/map_cloud", 1, true);
    odometry_ = node_.advertise<nav_msgs::Odometry>("mav/odometry", 100);
    status_ = node_.advertise<air_ground::VoStatus>("mav/vo_status", 100);
    ground_status_ = node_.advertise<air_ground::VoStatus>("ground/slam_status", 100);
    guess_ = node_.advertise<geometry_msgs::PoseWithCovarianceStamped>("initialpose", 1);
    coarse_.connect(node_, "alignment/coarse", begin);
    particles_.connect(node_, "alignment/particles", begin);
    costmap_.connect(node_, "alignment/costmap", begin);
    air_.connect(node_, "alignment/height_map_air", begin);
    ground_map_.connect(node_, "alignment/height_map_ground", begin);
    tf_.connect(node_, "/tf");
    tf_static_.connect(node_, "/tf_static");
    ASSERT_TRUE(spinUntil([&] {
      return cloud_.getNumSubscribers() > 0 && ground_.getNumSubscribers() > 0 && odometry_.getNumSubscribers() > 0 &&
             status_.getNumSubscribers() > 0 && ground_status_.getNumSubscribers() > 0 &&
             guess_.getNumSubscribers() > 0 && coarse_.subscriber.getNumPublishers() > 0 &&
             costmap_.subscriber.getNumPublishers() > 0 && particles_.subscriber.getNumPublishers() > 0 &&
             air_.subscriber.getNumPublishers() > 0 && ground_map_.subscriber.getNumPublishers() > 0;
    }));
    ASSERT_TRUE(call("heightmap_mcl/reset"));
    pause(20);
    clear();
  }

  void clear() {
    coarse_.messages.clear();
    particles_.messages.clear();
    costmap_.messages.clear();
    air_.messages.clear();
    ground_map_.messages.clear();
  }

  bool call(const std::string& service) {
    std_srvs::Trigger request;
    return ros_utils::callService(node_.resolveName(service), request) && request.response.success;
  }

  static sensor_msgs::PointCloud2 cloudMsg(const std::vector<Eigen::Vector3f>& points, const std::string& frame,
                                           const ros::Time& stamp) {
    std::vector<ros_utils::CloudPoint> cloud(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) cloud[i].position = points[i];
    std_msgs::Header header;
    header.frame_id = frame;
    header.stamp = stamp;
    return ros_utils::toMsg(cloud, ros_utils::CloudFields::kXyzIntensity, header);
  }

  /// True when the node has made its height map of it.
  bool sendGround(const syn::Run& run) {
    ground_.publish(cloudMsg(run.ground, "ground_map", stamp_));
    return spinUntil(
        [&] { return !ground_map_.messages.empty() && ground_map_.messages.back().header.stamp == stamp_; });
  }

  void sendOdometry(const Eigen::Vector3d& position, const ros::Time& stamp) {
    nav_msgs::Odometry odometry;
    odometry.header.frame_id = "mav_map";
    odometry.header.stamp = stamp;
    odometry.child_frame_id = "mav_base_link";
    odometry.pose.pose = ros_utils::toMsg(air_ground_common::yawPose(0, position));
    odometry_.publish(odometry);
  }

  void sendStatus(std::uint32_t map_id) { sendStatus(status_, map_id); }
  void sendGroundStatus(std::uint32_t map_id, std::uint32_t map_revision = 0) {
    sendStatus(ground_status_, map_id, map_revision);
  }
  void sendStatus(const ros::Publisher& publisher, std::uint32_t map_id, std::uint32_t map_revision = 0) {
    air_ground::VoStatus status;
    status.header.stamp = stamp_;
    status.map_id = map_id;
    status.map_revision = map_revision;
    publisher.publish(status);
  }

  geometry_msgs::PoseWithCovarianceStamped guessAt(const Pose& T_ground_base) const {
    geometry_msgs::PoseWithCovarianceStamped guess;
    guess.header.frame_id = "ground_map";
    guess.pose.pose = ros_utils::toMsg(T_ground_base);
    guess.pose.covariance[0] = guess.pose.covariance[7] = 0.1 * 0.1;
    guess.pose.covariance[35] = 0.05 * 0.05;
    return guess;
  }

  /// Publishes a cloud with odometry around its stamp and waits for the verdict on it.
  bool sendAerial(const heightmap_mcl::AerialCloud& cloud) {
    stamp_ += ros::Duration(2);
    sendOdometry(cloud.reference, stamp_ - ros::Duration(0.05));
    sendOdometry(cloud.reference, stamp_ + ros::Duration(0.05));
    cloud_.publish(cloudMsg(cloud.points, "mav_map", stamp_));
    return spinUntil([&] { return !coarse_.messages.empty() && coarse_.messages.back().header.stamp == stamp_; });
  }

  static syn::Run world(std::uint64_t seed, int clouds, syn::World kind = syn::World::kBoxes) {
    syn::Options options;
    options.seed = seed;
    options.world = kind;
    options.aerial_clouds = clouds;
    return syn::makeRun(options);
  }

  const AlignmentEstimate& last() const { return coarse_.messages.back(); }

  ros::NodeHandle node_;
  ros::Publisher cloud_, ground_, odometry_, status_, ground_status_, guess_;
  Inbox<AlignmentEstimate> coarse_;
  Inbox<geometry_msgs::PoseArray> particles_;
  Inbox<nav_msgs::OccupancyGrid> costmap_;
  Inbox<air_ground::HeightMap> air_, ground_map_;
  Inbox<tf2_msgs::TFMessage> tf_, tf_static_;
  ros_utils::NodeDiagnostics diagnostics_;
  ros::Time stamp_;
  inline static int test_number_ = 0;
};

/// A node of its own that publishes tf.
class TfNodeTest : public NodeTest {
 protected:
  TfNodeTest() : NodeTest("with_tf") {}
};

inline void expectSane(const AlignmentEstimate& e) {
  EXPECT_EQ(e.scale, 1) << "users multiply by it";
  EXPECT_EQ(e.header.frame_id, "ground_map");
  EXPECT_EQ(e.child_frame_id, "mav_map");
  EXPECT_EQ(e.stage, AlignmentEstimate::STAGE_COARSE);
  EXPECT_FALSE(e.reason.empty());
  const Pose T = ros_utils::fromMsg(e.pose.pose);
  EXPECT_TRUE(T.matrix().allFinite());
  const auto covariance = ros_utils::covarianceFromMsg(e.pose.covariance);
  EXPECT_GT(air_ground_common::symmetricEigen(covariance).values[0], 0);
  for (double v : {e.particle_spread, e.particle_spread_yaw, e.overlap, e.cost, e.reference_point.x,
                   e.reference_point.y, e.reference_point.z}) {
    EXPECT_TRUE(std::isfinite(v));
  }
}

}  // namespace heightmap_mcl_testing

using namespace heightmap_mcl_testing;
