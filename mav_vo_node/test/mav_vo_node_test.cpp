#include <air_ground/PosedImage.h>
#include <air_ground/SaveMap.h>
#include <air_ground/SaveTrajectory.h>
#include <air_ground/VoIncrement.h>
#include <air_ground/VoStatus.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <set>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/map_correction.h"
#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/trajectory.h"
#include "synthetic_camera.h"

namespace {

namespace ros_utils = air_ground_common::ros_utils;
using ros_utils::spinUntil;
using synthetic::Pose;

constexpr double kEpoch = 1000.0;  // stamp of the flight's start [s]

/// Publishes a flight and collects what the node says about it.
class MavVoNode : public testing::Test {
 protected:
  MavVoNode() : world_(3) {
    image_ = handle_.advertise<sensor_msgs::Image>("mav/camera/image_raw", 400);
    info_ = handle_.advertise<sensor_msgs::CameraInfo>("mav/camera/camera_info", 400);
    imu_ = handle_.advertise<sensor_msgs::Imu>("mav/imu/data", 5000);
    subscribers_ = {
        handle_.subscribe<nav_msgs::Odometry>(
            "mav/odometry", 1000, [this](const nav_msgs::Odometry::ConstPtr& m) { odometry_.push_back(*m); }),
        handle_.subscribe<air_ground::PosedImage>(
            "mav/posed_image", 1000, [this](const air_ground::PosedImage::ConstPtr& m) { posed_.push_back(m); }),
        handle_.subscribe<air_ground::VoIncrement>(
            "mav/vo_increment", 1000,
            [this](const air_ground::VoIncrement::ConstPtr& m) { increments_.push_back(*m); }),
        handle_.subscribe<air_ground::VoStatus>(
            "mav/vo_status", 1000, [this](const air_ground::VoStatus::ConstPtr& m) { status_.push_back(*m); }),
        handle_.subscribe<sensor_msgs::PointCloud2>(
            "mav/sparse_cloud", 100, [this](const sensor_msgs::PointCloud2::ConstPtr& m) { clouds_.push_back(*m); }),
        handle_.subscribe<nav_msgs::Path>("mav/corrected_path", 100,
                                          [this](const nav_msgs::Path::ConstPtr& m) { corrected_.push_back(m); }),
        handle_.subscribe<sensor_msgs::Image>("mav/track_image", 100,
                                              [this](const sensor_msgs::Image::ConstPtr& m) { tracks_.push_back(m); }),
        handle_.subscribe("/tf", 1000, &MavVoNode::onTf, this)};
    geometry_msgs::TransformStamped camera, imu;
    camera.header.frame_id = imu.header.frame_id = "mav_base_link";
    camera.child_frame_id = "mav_camera_optical_frame";
    imu.child_frame_id = "mav_imu_link";
    camera.transform = ros_utils::toTransformMsg(synthetic::T_imu_camera());
    imu.transform = ros_utils::toTransformMsg(Pose::Identity());
    static_tf_.sendTransform(std::vector<geometry_msgs::TransformStamped>{camera, imu});
  }

  void onTf(const ros::MessageEvent<tf2_msgs::TFMessage const>& event) {
    for (const auto& t : event.getMessage()->transforms) {
      authorities_[t.child_frame_id].insert(event.getPublisherName());
      parents_[t.child_frame_id] = t.header.frame_id;
      stamps_[t.child_frame_id].push_back(t.header.stamp);
    }
  }

  /// Until every topic is connected in both directions.
  bool waitForNode() {
    return spinUntil([this] {
      for (const auto& subscriber : subscribers_)
        if (subscriber.getNumPublishers() == 0) return false;
      return image_.getNumSubscribers() > 0 && info_.getNumSubscribers() > 0 && imu_.getNumSubscribers() > 0;
    });
  }

  static std_msgs::Header cameraHeader(double t) {
    std_msgs::Header header;
    header.stamp = ros::Time(kEpoch + t);
    header.frame_id = "mav_camera_optical_frame";
    return header;
  }

  /// Publishes a calibration; true when the node has it.
  bool recalibrate(double t, double factor) {
    info_.publish(ros_utils::toMsg(synthetic::camera().scaled(factor), cameraHeader(t)));
    return diagnostics_.awaitReceived(info_.getTopic(), cameraHeader(t).stamp);
  }

  /// Plays the flight from `begin` (rest) to `duration`, with images smaller by `factor`, or of another world; never
  /// more than 30 images ahead of the node.
  void play(double duration, double begin = 0, double factor = 1, bool elsewhere = false) {
    std::mt19937 random(11);
    cv::RNG grain(5);
    const auto samples = flight_.imuSamples(begin, duration, 200, visual_frontend::ImuNoise{1.7e-4, 2.9e-3, 2e-5, 6e-4},
                                            {{0.008, -0.012, 0.005}, {0.05, -0.04, 0.06}}, random);
    std::size_t next = 0;
    const std::size_t before = status_.size();
    std::size_t sent = 0;
    ros::Time last;
    for (int i = static_cast<int>(std::lround(begin / 0.05)) + 1; 0.05 * i <= duration; ++i) {
      const double t = 0.05 * i;
      for (; next < samples.size() && samples[next].stamp <= t + 1e-9; ++next) {
        sensor_msgs::Imu msg;
        msg.header.stamp = ros::Time(kEpoch + samples[next].stamp);
        msg.header.frame_id = "mav_imu_link";
        msg.orientation_covariance[0] = -1;
        const auto& s = samples[next];
        msg.angular_velocity.x = next % 97 == 50 ? std::nan("") : s.angular_velocity.x();
        msg.angular_velocity.y = s.angular_velocity.y();
        msg.angular_velocity.z = s.angular_velocity.z();
        msg.linear_acceleration.x = s.specific_force.x();
        msg.linear_acceleration.y = s.specific_force.y();
        msg.linear_acceleration.z = next % 89 == 30 ? INFINITY : s.specific_force.z();
        imu_.publish(msg);
      }
      const Pose T = flight_.T_world_imu(t) * synthetic::T_imu_camera();
      truth_camera_.push_back({kEpoch + t, T});
      truth_base_.push_back({kEpoch + t, flight_.T_world_imu(t)});
      const std_msgs::Header header = cameraHeader(t);
      last = header.stamp;
      const auto camera = synthetic::camera().scaled(factor);
      info_.publish(ros_utils::toMsg(camera, header));
      const cv::Mat image = (elsewhere ? other_world_ : world_).render(camera, T, 1.0, &grain);
      image_.publish(ros_utils::toMsg(image, "mono8", header));
      ++sent;
      ros::spinOnce();
      spinUntil([&] { return sent <= status_.size() - before + 30; }, 4000);
    }
    const auto ended = [&](const auto& messages) { return !messages.empty() && messages.back().header.stamp == last; };
    EXPECT_TRUE(spinUntil([&] { return ended(status_); }));
    EXPECT_GE(status_.size() - before + 2, sent) << "a status with every image";
    // Of what goes out with an image, an increment is the last.
    if (ended(status_) && status_.back().state == air_ground::VoStatus::STATE_TRACKING) {
      EXPECT_TRUE(spinUntil([&] { return ended(increments_) && ended(odometry_); }));
    }
    ros_utils::pause(20);
  }

  ros::NodeHandle handle_;
  tf2_ros::StaticTransformBroadcaster static_tf_;
  synthetic::PlateWorld world_, other_world_{77};
  synthetic::Flight flight_;
  ros::Publisher image_, info_, imu_;
  std::vector<ros::Subscriber> subscribers_;
  air_ground_common::Trajectory truth_camera_, truth_base_;
  std::vector<nav_msgs::Odometry> odometry_;
  std::vector<air_ground::PosedImage::ConstPtr> posed_;
  std::vector<nav_msgs::Path::ConstPtr> corrected_;
  std::vector<air_ground::VoIncrement> increments_;
  std::vector<air_ground::VoStatus> status_;
  std::vector<sensor_msgs::PointCloud2> clouds_;
  std::vector<sensor_msgs::Image::ConstPtr> tracks_;
  ros_utils::NodeDiagnostics diagnostics_{"mav_vo"};
  std::map<std::string, std::set<std::string>> authorities_;
  std::map<std::string, std::string> parents_;
  std::map<std::string, std::vector<ros::Time>> stamps_;
};

TEST_F(MavVoNode, FliesALoopedBag) {
  ASSERT_TRUE(waitForNode()) << "mav_vo_node did not come up";
  const double duration = 12.0;
  play(duration);

  // States in order; never a word of metres before the scale is known.
  const auto begun = std::find_if(status_.begin(), status_.end(), [](const air_ground::VoStatus& s) {
    return s.state != air_ground::VoStatus::STATE_WAITING;  // for calibration or mountings, on a busy machine
  });
  ASSERT_NE(begun, status_.end());
  EXPECT_EQ(begun->state, air_ground::VoStatus::STATE_INITIALIZING);
  EXPECT_EQ(status_.back().state, air_ground::VoStatus::STATE_TRACKING);
  for (const auto& s : status_)
    EXPECT_TRUE(s.state == air_ground::VoStatus::STATE_TRACKING || !s.reason.empty()) << int(s.state);
  ASSERT_GT(odometry_.size(), 60u);
  ASSERT_FALSE(posed_.empty());
  EXPECT_FALSE(posed_.front()->metric);

  // Frames, numbers, accuracy.
  air_ground_common::Trajectory estimate;
  for (const auto& m : odometry_) {
    EXPECT_EQ(m.header.frame_id, "mav_map");
    EXPECT_EQ(m.child_frame_id, "mav_base_link");
    const Pose T = ros_utils::fromMsg(m.pose.pose);
    ASSERT_TRUE(T.matrix().allFinite());
    for (int i = 0; i < 6; ++i) EXPECT_GT(m.pose.covariance[7 * i], 0);
    estimate.push_back({m.header.stamp.toSec(), T});
  }
  const auto error =
      air_ground_common::absoluteTrajectoryError(truth_base_, estimate, air_ground_common::Alignment::kYawTranslation);
  std::printf("published: ATE %.4f m over %.2f m\n", error.rmse, error.path_length);
  EXPECT_LT(error.rmse, 0.02 * error.path_length);
  std::size_t metric = 0;
  for (const auto& p : posed_) {
    EXPECT_EQ(p->header.frame_id, "mav_map");
    EXPECT_EQ(p->camera_info.header.frame_id, "mav_camera_optical_frame");
    EXPECT_TRUE(p->image.data.empty());
    EXPECT_LT(p->compressed.data.size(), 752u * 480 / 3);
    EXPECT_EQ(ros_utils::greyFromMsg(*p).size(), cv::Size(752, 480));
    EXPECT_GT(p->depth_min, 0);
    EXPECT_GT(p->depth_max, p->depth_min);
    ASSERT_TRUE(std::isfinite(p->pose.pose.position.x) && std::isfinite(p->pose.covariance[0]));
    metric += p->metric;
  }
  // The posed image is of the camera, the odometry of the base.
  EXPECT_LE(metric, odometry_.size());
  EXPECT_GT(metric, odometry_.size() / 3);
  const auto same_image = std::find_if(odometry_.rbegin(), odometry_.rend(), [this](const nav_msgs::Odometry& m) {
    return m.header.stamp == posed_.back()->header.stamp;
  });
  ASSERT_NE(same_image, odometry_.rend());
  const Pose T_camera = ros_utils::fromMsg(posed_.back()->pose.pose),
             T_base = ros_utils::fromMsg(same_image->pose.pose);
  EXPECT_LT(((T_base * synthetic::T_imu_camera()).translation() - T_camera.translation()).norm(), 1e-6);
  // Corrections of the map: cameras, images that were posed among them.
  std::printf("%zu corrections of the map\n", corrected_.size());
  for (const auto& path : corrected_) {
    EXPECT_EQ(path->header.frame_id, "mav_map");
    const auto poses = ros_utils::fromMsg(*path);
    ASSERT_EQ(poses.size(), path->poses.size()) << "a stamp twice";
    const auto first = std::find_if(posed_.begin(), posed_.end(), [](const auto& p) { return p->metric; });
    const auto T = air_ground_common::poseOfImage(poses, static_cast<std::int64_t>((*first)->header.stamp.toNSec()));
    ASSERT_TRUE(T);
    EXPECT_LT((T->translation() - ros_utils::fromMsg((*first)->pose.pose).translation()).norm(), 0.1);
  }
  // Image rate: a pose with every image once metric.
  EXPECT_NEAR(static_cast<double>(odometry_.size()),
              (odometry_.back().header.stamp - odometry_.front().header.stamp).toSec() / 0.05 + 1, 3);

  for (const auto& v : increments_) {
    for (int i = 0; i < 4; ++i) EXPECT_GT(v.covariance[5 * i], 0);
    EXPECT_GT(v.header.stamp, v.previous_stamp);
    EXPECT_GT(v.inliers, 0u);
  }
  // An increment says where the later base is in the earlier one.
  const auto& last = increments_.back();
  const auto a = air_ground_common::poseAt(truth_base_, last.previous_stamp.toSec()),
             b = air_ground_common::poseAt(truth_base_, last.header.stamp.toSec());
  ASSERT_TRUE(a && b);
  EXPECT_LT((ros_utils::fromMsg(last.relative_pose).translation() - (a->inverse() * *b).translation()).norm(), 0.01);

  ASSERT_FALSE(clouds_.empty());
  EXPECT_EQ(clouds_.back().header.frame_id, "mav_map");
  EXPECT_GT(ros_utils::cloudFromMsg(clouds_.back()).size(), 100u);
  ASSERT_FALSE(tracks_.empty());
  EXPECT_EQ(tracks_.back()->encoding, "bgr8");

  // One authority an edge, no stamp twice.
  EXPECT_EQ(parents_["mav_odom"], "mav_map");
  EXPECT_EQ(parents_["mav_base_link"], "mav_odom");
  for (const char* child : {"mav_odom", "mav_base_link"}) {
    EXPECT_EQ(authorities_[child].size(), 1u) << child;
    EXPECT_EQ(std::set<ros::Time>(stamps_[child].begin(), stamps_[child].end()).size(), stamps_[child].size()) << child;
  }

  // Files.
  air_ground::SaveTrajectory trajectory;
  trajectory.request.path = "/tmp/mav_vo_node_test_" + std::to_string(getpid()) + ".txt";
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_trajectory", trajectory));
  EXPECT_TRUE(trajectory.response.success) << trajectory.response.message;
  const auto saved = air_ground_common::readTum(trajectory.request.path);
  EXPECT_EQ(saved.size(), trajectory.response.poses);
  EXPECT_LT(
      air_ground_common::absoluteTrajectoryError(truth_camera_, saved, air_ground_common::Alignment::kYawTranslation)
          .rmse,
      0.01 * error.path_length);
  std::remove(trajectory.request.path.c_str());
  air_ground::SaveMap map;
  for (const std::string extension : {".ply", ".pcd"}) {
    map.request.path = "/tmp/mav_vo_node_test_" + std::to_string(getpid()) + extension;
    ASSERT_TRUE(ros_utils::callService("/mav_vo/save_map", map));
    EXPECT_TRUE(map.response.success) << map.response.message;
    std::remove(map.request.path.c_str());
  }
  map.request.path = "/nowhere/map.ply";
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_map", map));
  EXPECT_FALSE(map.response.success);

  // The bag loops: a new map, and metres again only when they are known again.
  const std::uint32_t first_map = status_.back().map_id;
  odometry_.clear();
  posed_.clear();
  status_.clear();
  play(duration);
  ASSERT_FALSE(status_.empty());
  EXPECT_GT(status_.back().map_id, first_map);
  EXPECT_EQ(status_.back().state, air_ground::VoStatus::STATE_TRACKING);
  // One of the map before may have come late.
  const auto posed = std::find_if(posed_.begin(), posed_.end(), [&](const auto& p) { return p->map_id > first_map; });
  EXPECT_FALSE(posed == posed_.end() || (*posed)->metric);
  EXPECT_FALSE(odometry_.empty());

  // The reset service does the same.
  std_srvs::Trigger reset;
  const std::uint32_t second_map = status_.back().map_id;
  ASSERT_TRUE(ros_utils::callService("/mav_vo/reset", reset));
  EXPECT_TRUE(reset.response.success);
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_trajectory", trajectory));
  EXPECT_FALSE(trajectory.response.success);
  status_.clear();
  play(2.0);
  ASSERT_FALSE(status_.empty());
  EXPECT_GT(status_.back().map_id, second_map);

  EXPECT_TRUE(diagnostics_.await("IMU samples refused: not a finite number", 1));
}

// A flight that never becomes metric, or has not yet, leaves its map's own trajectory.
TEST_F(MavVoNode, SavesATrajectoryWithoutScale) {
  ASSERT_TRUE(waitForNode());
  const auto scaling = [this] {
    return !status_.empty() && status_.back().state == air_ground::VoStatus::STATE_SCALING;
  };
  double t = 0;
  for (; t < 9 && !scaling(); t += 0.5) play(t + 0.5, t);
  play(t + 1.0, t);
  ASSERT_TRUE(scaling());
  air_ground::SaveTrajectory trajectory;
  trajectory.request.path = "/tmp/mav_vo_node_test_" + std::to_string(getpid()) + "_unscaled.txt";
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_trajectory", trajectory));
  EXPECT_TRUE(trajectory.response.success) << trajectory.response.message;
  EXPECT_NE(trajectory.response.message.find("unit: the map's own (scale unknown)"), std::string::npos)
      << trajectory.response.message;
  std::string line;
  std::ifstream file(trajectory.request.path);
  std::getline(file, line);
  EXPECT_EQ(line.rfind("# unit: the map's own (scale unknown): ", 0), 0u) << line;
  const auto saved = air_ground_common::readTum(trajectory.request.path);
  EXPECT_EQ(saved.size(), trajectory.response.poses);
  ASSERT_GT(saved.size(), 5u);
  const auto error =
      air_ground_common::absoluteTrajectoryError(truth_camera_, saved, air_ground_common::Alignment::kSimilarity);
  EXPECT_LT(error.rmse, 0.02 * error.path_length + 0.005);
  std::remove(trajectory.request.path.c_str());
}

// Lost for too long, a map ends; what it knew of the flight is saved with the next one's.
TEST_F(MavVoNode, SavesTheTrajectoryOfAMapThatEnded) {
  ASSERT_TRUE(waitForNode());
  play(9.0);
  ASSERT_EQ(status_.back().state, air_ground::VoStatus::STATE_TRACKING);
  const std::uint32_t before = status_.back().map_id;
  play(13.4, 9.0, 1, true);  // lost_timeout is 4 s
  EXPECT_GT(status_.back().map_id, before);
  air_ground::SaveTrajectory trajectory;
  const std::string path = "/tmp/mav_vo_node_test_" + std::to_string(getpid()) + "_ended";
  trajectory.request.path = path + ".txt";
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_trajectory", trajectory));
  EXPECT_TRUE(trajectory.response.success) << trajectory.response.message;
  EXPECT_GT(trajectory.response.poses, 100u) << "there is no other map yet";
  play(16.0, 13.4);
  ASSERT_EQ(status_.back().state, air_ground::VoStatus::STATE_SCALING);
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_trajectory", trajectory));
  EXPECT_GT(trajectory.response.poses, 100u) << "the metric one is the one that is meant";
  EXPECT_NE(trajectory.response.message.find("; of another map "), std::string::npos) << trajectory.response.message;
  const auto ended = air_ground_common::readTum(path + ".txt"),
             present = air_ground_common::readTum(path + "_map1.txt");
  EXPECT_LT(ended.back().stamp, kEpoch + 9.5);
  ASSERT_FALSE(present.empty());
  EXPECT_GT(present.front().stamp, kEpoch + 12.9);
  for (const char* end : {".txt", "_map1.txt"}) std::remove((path + end).c_str());
}

TEST_F(MavVoNode, BeginsANewMapWithAnotherCalibration) {
  ASSERT_TRUE(waitForNode());
  play(5.0);
  ASSERT_FALSE(posed_.empty());
  EXPECT_EQ(ros_utils::greyFromMsg(*posed_.back()).cols, 752);
  const std::uint32_t before = status_.back().map_id;
  posed_.clear();
  ASSERT_TRUE(recalibrate(5.01, 0.5));
  play(9.0, 5.0, 0.5);
  EXPECT_GT(status_.back().map_id, before);
  ASSERT_FALSE(posed_.empty());
  for (const auto& p : posed_) {
    const int width = ros_utils::greyFromMsg(*p).cols;
    EXPECT_EQ(width, static_cast<int>(p->camera_info.width));
    EXPECT_NEAR(p->camera_info.K[0], width == 752 ? 420 : 210, 1e-6);
  }
  EXPECT_EQ(ros_utils::greyFromMsg(*posed_.back()).cols, 376);

  // What was flown with the first one is saved, too.
  air_ground::SaveTrajectory trajectory;
  const std::string path = "/tmp/mav_vo_node_test_" + std::to_string(getpid()) + "_recalibrated";
  trajectory.request.path = path + ".txt";
  ASSERT_TRUE(ros_utils::callService("/mav_vo/save_trajectory", trajectory));
  EXPECT_TRUE(trajectory.response.success) << trajectory.response.message;
  EXPECT_NE(trajectory.response.message.find("; of another map "), std::string::npos) << trajectory.response.message;
  for (const char* end : {".txt", "_map1.txt"}) std::remove((path + end).c_str());
}

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "mav_vo_node_test");
  ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
