// The running node: keyframes, landmarks and posed images in, an alignment in the right frames out; what it refuses.
#include <air_ground/AlignmentEstimate.h>
#include <air_ground/MapKeyframes.h>
#include <air_ground/PosedImage.h>
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>

#include <limits>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "textured_corner.h"

namespace view_match {
namespace {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;

class ViewMatchNode : public testing::Test, protected CornerScene {
 protected:
  ViewMatchNode() : corner_(1) {
    keyframes_ = handle_.advertise<air_ground::MapKeyframes>("ground/map_keyframes", 10);
    images_ = handle_.advertise<air_ground::PosedImage>("mav/posed_image", 10);
    sparse_ = handle_.advertise<sensor_msgs::PointCloud2>("mav/sparse_cloud", 10);
    views_ = handle_.subscribe<AlignmentEstimate>("alignment/views", 100,
                                                  [this](const AlignmentEstimate::ConstPtr& m) { last_ = *m; });
  }

  void SetUp() override {
    static double start = 1000;
    now_ = start += 1000;
    ASSERT_TRUE(ros_utils::spinUntil([this] {
      return keyframes_.getNumSubscribers() > 0 && images_.getNumSubscribers() > 0 && sparse_.getNumSubscribers() > 0 &&
             views_.getNumPublishers() > 0;
    }));
  }

  std_msgs::Header header(const std::string& frame) {
    std_msgs::Header out;
    out.stamp = ros::Time(now_ += 0.5);
    out.frame_id = frame;
    return out;
  }

  air_ground::MapKeyframes keyframes(std::uint32_t map_id) {
    air_ground::MapKeyframes msg;
    msg.header = header("ground_map");
    msg.map_id = map_id;
    for (const KeyframeView& view : groundViews(corner_)) {
      msg.ids.push_back(view.id);
      msg.poses.push_back(ros_utils::toMsg(view.T_ground_camera));
      air_ground::KeyframeFeatures features;
      features.id = view.id;
      for (const auto& p : view.points) {
        geometry_msgs::Point32 point;
        point.x = static_cast<float>(p.x());
        point.y = static_cast<float>(p.y());
        point.z = static_cast<float>(p.z());
        features.points.push_back(point);
      }
      features.descriptors.assign(view.descriptors.datastart, view.descriptors.dataend);
      msg.features.push_back(features);
    }
    return msg;
  }

  /// The MAV's view with what its map holds of it.
  void fly(int i, const std::string& frame, bool metric, std::uint32_t map_id = 1) {
    cv::Mat depth;
    const cv::Mat grey = render(corner_, flown(i), &depth);
    std::vector<ros_utils::CloudPoint> points;
    for (const Eigen::Vector3f& p : landmarks(depth, flown(i))) {
      points.emplace_back();
      points.back().position = p;
    }
    sparse_.publish(ros_utils::toMsg(points, ros_utils::CloudFields::kXyz, header(frame)));
    ros_utils::pause(10);  // the landmarks first
    air_ground::PosedImage msg;
    msg.header = header(frame);
    msg.image = ros_utils::toMsg(grey, "mono8", msg.header);
    msg.camera_info = ros_utils::toMsg(camera, msg.header);
    msg.pose.pose = ros_utils::toMsg(inMavMap(flown(i)));
    msg.metric = metric;
    msg.map_id = map_id;
    images_.publish(msg);
    ros_utils::pause(20);
  }

  bool awaitStatus(std::uint8_t status) {
    return ros_utils::spinUntil([&] { return last_ && last_->status == status; });
  }
  std::string reason() const { return last_ ? last_->reason : "no estimate came"; }

  const Corner corner_;
  ros::NodeHandle handle_;
  ros::Publisher keyframes_, images_, sparse_;
  ros::Subscriber views_;
  ros_utils::NodeDiagnostics diagnostics_{"view_match"};
  std::optional<AlignmentEstimate> last_;
  double now_ = 0;
};

TEST_F(ViewMatchNode, TellsTheSimilarityOfAMapWithoutScaleAndForgetsWithTheGroundMap) {
  keyframes_.publish(keyframes(1));
  ASSERT_TRUE(awaitStatus(AlignmentEstimate::STATUS_SEARCHING));
  for (int i = 0; i < 7; ++i) fly(i, "mav_visual_map", false);
  ASSERT_TRUE(awaitStatus(AlignmentEstimate::STATUS_CONVERGED)) << reason();
  EXPECT_EQ(last_->header.frame_id, "ground_map");
  EXPECT_EQ(last_->child_frame_id, "mav_visual_map");
  EXPECT_EQ(last_->map_id, 1u);
  EXPECT_EQ(last_->ground_map_id, 1u);
  const Pose T = ros_utils::fromMsg(last_->pose.pose);
  const Similarity found{last_->scale, T.linear(), T.translation()};
  EXPECT_NEAR(found.scale / truth.scale, 1, 0.02);
  EXPECT_LT((found * inMavMap(flown(3)).translation() - flown(3).translation()).norm(), 0.05);
  EXPECT_GT(last_->scale_stddev, 0);
  EXPECT_LT(last_->pose.covariance[0], 0.15 * 0.15);

  auto other = keyframes(2);
  other.features.clear();
  other.ids.clear();
  other.poses.clear();
  keyframes_.publish(other);
  ASSERT_TRUE(awaitStatus(AlignmentEstimate::STATUS_SEARCHING)) << reason();
  EXPECT_GE(last_->pose.covariance[0], 1e6);
  EXPECT_EQ(last_->ground_map_id, 2u);
}

// Images wait for the ground robot: by their stamp nobody may take the alignment for one of the map before.
TEST_F(ViewMatchNode, WhatWaitingImagesTellIsStampedWithTheNewestOfThem) {
  const std::string frame = "mav_visual_map";
  keyframes_.publish(keyframes(11));
  for (int i = 0; i < 7; ++i) fly(i, frame, false);
  ASSERT_TRUE(awaitStatus(AlignmentEstimate::STATUS_CONVERGED)) << reason();
  auto other = keyframes(12);
  other.features.clear();
  other.ids.clear();
  other.poses.clear();
  keyframes_.publish(other);
  ASSERT_TRUE(awaitStatus(AlignmentEstimate::STATUS_SEARCHING)) << reason();
  const double ended = now_;
  for (int i = 0; i < 7; ++i) fly(i, frame, false, 2);
  const ros::Time newest(now_);
  ASSERT_TRUE(diagnostics_.awaitReceived("/mav/posed_image", newest));
  keyframes_.publish(keyframes(12));
  ASSERT_TRUE(awaitStatus(AlignmentEstimate::STATUS_CONVERGED)) << reason();
  EXPECT_EQ(last_->map_id, 2u);
  EXPECT_GT(last_->header.stamp.toSec(), ended);
  EXPECT_LE(last_->header.stamp, newest);
}

TEST_F(ViewMatchNode, BadInputIsCountedNotFatal) {
  auto wrong = keyframes(3);
  wrong.features[1].descriptors.resize(40);
  keyframes_.publish(wrong);
  wrong = keyframes(3);
  wrong.poses.pop_back();
  keyframes_.publish(wrong);
  wrong = keyframes(3);
  wrong.poses[0].position.x = std::numeric_limits<double>::quiet_NaN();
  keyframes_.publish(wrong);
  wrong = keyframes(3);
  wrong.header.frame_id = "elsewhere";
  keyframes_.publish(wrong);
  air_ground::PosedImage image;
  image.header = header("mav_visual_map");
  images_.publish(image);
  EXPECT_TRUE(diagnostics_.await("keyframes not usable", 3));
  EXPECT_TRUE(diagnostics_.await("keyframes in frame", 1));
  EXPECT_TRUE(diagnostics_.await("posed images not usable", 1));
  // It works on.
  keyframes_.publish(keyframes(4));
  for (int i = 0; i < 7; ++i) fly(i, "mav_visual_map", false);
  image.header.stamp = ros::Time(0xFFFFFFFFu, 0);  // further from the last than a ros::Duration can hold
  images_.publish(image);
  ASSERT_TRUE(diagnostics_.awaitReceived("/mav/posed_image", image.header.stamp));
  keyframes_.publish(keyframes(4));
  EXPECT_TRUE(awaitStatus(AlignmentEstimate::STATUS_CONVERGED)) << reason();
}

}  // namespace
}  // namespace view_match

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "view_match_node_test");
  ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
