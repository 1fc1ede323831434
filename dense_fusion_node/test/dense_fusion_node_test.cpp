// The node from outside: rendered flights in, clouds and depth maps out.
#include <air_ground/CloudCorrections.h>
#include <air_ground/SaveMap.h>
#include <nav_msgs/Path.h>
#include <sensor_msgs/image_encodings.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <future>
#include <limits>
#include <set>

#include "../src/ros/map_store.h"
#include "../src/ros/work_queue.h"
#include "air_ground_common/mesh.h"
#include "air_ground_common/statistics.h"
#include "flight_fixture.h"

namespace {

namespace ros_utils = air_ground_common::ros_utils;
using dense_fusion::testing::kFrames;
using ros_utils::spinUntil;

class DenseFusionNodeTest : public dense_fusion::testing::FlightTest {
 protected:
  void SetUp() override {
    sparse_publisher_ = handle_.advertise<sensor_msgs::PointCloud2>("mav/sparse_cloud", 10);
    ASSERT_TRUE(spinUntil([&] { return sparse_publisher_.getNumSubscribers() > 0; }));
    FlightTest::SetUp();
  }

  // Points all over the flight's view at one height.
  sensor_msgs::PointCloud2 sparseCloud(double stamp, float z) {
    std::vector<ros_utils::CloudPoint> points;
    for (int i = 0; i < 400; ++i) {
      ros_utils::CloudPoint point;
      point.position = {-1.f + 0.1f * static_cast<float>(i % 20), -1.f + 0.1f * static_cast<float>(i / 20), z};
      points.push_back(point);
    }
    std_msgs::Header header;
    header.stamp.fromSec(stamp);
    header.frame_id = "mav_map";
    return ros_utils::toMsg(points, ros_utils::CloudFields::kXyz, header);
  }

  void checkOutput(double shift_x) {
    ASSERT_FALSE(clouds_.empty());
    ASSERT_EQ(clouds_.size(), depth_maps_.size());
    const auto scene = dense_fusion::testing::boxScene();
    for (const auto& cloud : clouds_) {
      EXPECT_EQ(cloud->header.frame_id, "mav_map");
      EXPECT_TRUE(sent_.count(cloud->header.stamp)) << "the stamp is no reference image's";
      std::size_t dropped = 0, wrong = 0, boxes = 0;
      const auto points = ros_utils::cloudFromMsg(*cloud, &dropped);
      EXPECT_EQ(dropped, 0u) << "points that are not finite";
      ASSERT_GT(points.size(), 5000u);
      std::set<int> greys;
      for (const auto& p : points) {
        const double x = p.position.x() / size_ - shift_x, y = p.position.y() / size_, z = p.position.z() / size_;
        bool fits = std::abs(z - scene.heightAt(x, y)) < 0.06;
        for (const auto& b : scene.boxes)
          fits = fits || (x > b.lower.x() - 0.06 && x < b.upper.x() + 0.06 && y > b.lower.y() - 0.06 &&
                          y < b.upper.y() + 0.06 && z > -0.06 && z < b.upper.z() + 0.06);
        wrong += !fits;
        boxes += z > 0.2;
        greys.insert(p.rgb[0]);
      }
      EXPECT_LT(wrong, points.size() / 25);
      EXPECT_GT(boxes, 200u);
      EXPECT_GT(greys.size(), 50u);
    }
    for (const auto& map : depth_maps_) {
      EXPECT_EQ(map->header.frame_id, "mav_map");
      const cv::Mat depth = ros_utils::depthFromMsg(map->depth), confidence = ros_utils::depthFromMsg(map->confidence);
      std::size_t valid = 0;
      for (int v = 0; v < depth.rows; ++v)
        for (int u = 0; u < depth.cols; ++u)
          valid += depth.at<float>(v, u) > 0.9 * size_ && depth.at<float>(v, u) < 2.4 * size_;
      EXPECT_GT(valid, depth.total() / 2);
      EXPECT_GT(map->frames, 10u);
      EXPECT_GT(map->camera_info.K[0], 100);
    }
  }

  ros::Publisher sparse_publisher_;
};

TEST_F(DenseFusionNodeTest, ReconstructsAFlightInTheMapFrame) {
  fly(100, 1);
  flushToCloud(100);
  checkOutput(0);
}

TEST_F(DenseFusionNodeTest, ReconstructsFromHighAbove) {
  size_ = 6;  // 12 m: what frames 0.12 m apart tell of depth there is nothing
  fly(150, 1);
  flushToCloud(150);
  checkOutput(0);
}

TEST_F(DenseFusionNodeTest, SaysWhyThereIsNoDepth) {
  const cv::Mat grey(camera_->height, camera_->width, CV_8UC1, cv::Scalar(127));
  for (int i = 0; i < kFrames; ++i) {
    auto msg = message(i, 180, 1);
    msg.compressed = sensor_msgs::CompressedImage();
    msg.image = ros_utils::toMsg(grey, "mono8", msg.header);
    msg.pose.pose.position.x = 0.1 * i;
    send(msg);
    ros_utils::pause(2);
  }
  ASSERT_TRUE(spinUntil([&] {
    return diagnostics_.refresh() && diagnostics_.message().find("depth maps are too poor") != std::string::npos;
  })) << diagnostics_.message();
}

TEST_F(DenseFusionNodeTest, ImagesWithoutScaleAreIgnored) {
  for (int i = 0; i < kFrames; ++i) {
    auto msg = message(i, 200, 1);
    msg.metric = false;
    send(msg);
    ros_utils::pause(2);
  }
  flush(200);
  EXPECT_TRUE(clouds_.empty());
}

TEST_F(DenseFusionNodeTest, SurvivesBadInput) {
  const std::string refused = "input refused: ", late = "images refused: repeated or out of order";
  ASSERT_TRUE(diagnostics_.refresh());
  const int refused_before = diagnostics_.counted(refused), late_before = diagnostics_.counted(late);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  auto msg = message(0, 300, 1);
  msg.pose.pose.position.x = nan;
  publisher_.publish(msg);
  msg = message(1, 300, 1);
  msg.pose.pose.orientation.w = msg.pose.pose.orientation.x = msg.pose.pose.orientation.y =
      msg.pose.pose.orientation.z = 0;
  publisher_.publish(msg);
  msg = message(2, 300, 1);
  msg.camera_info.K[0] = 0;
  publisher_.publish(msg);
  msg = message(3, 300, 1);
  msg.compressed.data.resize(10);
  publisher_.publish(msg);
  msg = message(4, 300, 1);
  msg.image.encoding = "nonsense";
  publisher_.publish(msg);
  msg = message(5, 300, 1);
  msg.depth_min = std::numeric_limits<float>::quiet_NaN();
  publisher_.publish(msg);
  msg = message(6, 300, 1);
  msg.image.data.resize(10);
  publisher_.publish(msg);
  for (int i = 0; i < 3; ++i) publisher_.publish(message(8, 300, 1));  // repeated
  publisher_.publish(message(3, 300, 1));                              // late
  fly(301, 1);
  flushToCloud(301);
  checkOutput(0);
  ASSERT_TRUE(diagnostics_.refresh());
  EXPECT_EQ(diagnostics_.counted(refused) - refused_before, 6);  // two poses, a calibration, two sizes, an encoding
  EXPECT_EQ(diagnostics_.counted(late) - late_before, 3);
}

TEST_F(DenseFusionNodeTest, ANewMapStartsAfresh) {
  fly(400, 1);
  const std::string path = "/tmp/dense_fusion_node_test_" + std::to_string(getpid()) + ".ply";
  air_ground::SaveMap save;
  double start = 410;
  // Another map, and the same one corrected as a whole.
  for (const std::uint32_t revision : {0, 1}) {
    fly(start, 2, 10 + 10 * revision, revision);
    flush(start);
    start += 10;
    save.request.path = path;
    ASSERT_TRUE(ros_utils::callService("dense_fusion/save_map", save));
    ASSERT_TRUE(save.response.success) << save.response.message;
    const auto points = air_ground_common::readPlyPoints(path);
    std::remove(path.c_str());
    EXPECT_EQ(points.size(), save.response.points);
    ASSERT_GT(points.size(), 5000u);
    for (const auto& p : points) {
      ASSERT_GT(p.position.x(), 5 + 10 * revision) << "a point of the old map";
      ASSERT_EQ(p.source, 1);
    }
  }
  save.request.path = "/nonexistent/map.ply";
  ASSERT_TRUE(ros_utils::callService("dense_fusion/save_map", save));
  EXPECT_FALSE(save.response.success);

  // What ended is not lost.
  const std::string folder = ros::param::param<std::string>("/dense_fusion/autosave", "");
  const auto kept = [&folder] {
    std::vector<std::string> maps;
    for (const auto& entry : std::filesystem::directory_iterator(folder))
      if (entry.path().filename().string().find("_map_map") != std::string::npos) maps.push_back(entry.path().string());
    return maps;
  };
  for (const std::string& map : kept()) EXPECT_GT(air_ground_common::readPlyPoints(map).size(), 5000u) << map;
  const std::size_t before = kept().size();
  EXPECT_GE(before, 2u);
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("dense_fusion/reset", reset));
  EXPECT_TRUE(spinUntil([&] { return kept().size() == before + 1; })) << "the map at a reset is lost";
  std::filesystem::remove_all(folder);
}

TEST_F(DenseFusionNodeTest, StartsAfreshWhenABagLoops) {
  fly(600, 1, 10);
  sparse_publisher_.publish(sparseCloud(600, 0.4f));
  flushToCloud(600);
  publisher_.publish(message(0, 550, 1));
  ASSERT_TRUE(taken(message(0, 550, 1)));
  clouds_.clear();
  depth_maps_.clear();
  fly(550.05, 1);
  flushToCloud(550.05);
  // What was flown after the jump is there, in the same map id, and is not mixed with what was flown before it.
  ASSERT_FALSE(clouds_.empty());
  std::size_t dropped = 0;
  const auto points = ros_utils::cloudFromMsg(*clouds_.back(), &dropped);
  ASSERT_GT(points.size(), 5000u);
  std::size_t floor = 0;
  for (const auto& p : points) {
    ASSERT_LT(p.position.x(), 5);
    floor += std::abs(p.position.z()) < 0.05;
  }
  EXPECT_GT(floor, points.size() / 4);
  for (const auto& cloud : clouds_) EXPECT_LT(cloud->header.stamp.toSec(), 560) << "of the time before the jump";
}

TEST_F(DenseFusionNodeTest, NothingIncompleteIsSavedAndServicesLetImagesIn) {
  ros::Publisher images = handle_.advertise<air_ground::PosedImage>("impatient/mav/posed_image", 100);
  ros_utils::NodeDiagnostics diagnostics("impatient/dense_fusion");
  ASSERT_TRUE(spinUntil([&] { return images.getNumSubscribers() > 0; }));
  for (int i = 0; i < kFrames; ++i) images.publish(message(i, 800, 1));
  ASSERT_TRUE(diagnostics.awaitReceived(images.getTopic(), message(kFrames - 1, 800, 1).header.stamp));
  const std::string path = "/tmp/dense_fusion_node_test_" + std::to_string(getpid()) + ".pcd";
  air_ground::SaveMap save;
  save.request.path = path;
  bool refused = false;
  for (int i = 0; i < 600 && !save.response.success; ++i) {
    ASSERT_TRUE(ros_utils::callService("impatient/dense_fusion/save_map", save));
    const bool waiting = save.response.message.find("still waiting") != std::string::npos;
    EXPECT_FALSE(waiting && save.response.success);
    refused = refused || waiting;
    ros::WallDuration(0.1).sleep();
  }
  EXPECT_TRUE(refused) << "a map was saved, or none was found, without waiting for the images";
  EXPECT_TRUE(save.response.success) << save.response.message;
  EXPECT_GT(save.response.points, 5000u);
  std::remove(path.c_str());
}

TEST_F(DenseFusionNodeTest, FlushesByItselfWhenTheInputEnds) {
  ros::Publisher images = handle_.advertise<air_ground::PosedImage>("alone/mav/posed_image", 100);
  int clouds = 0;
  const ros::Subscriber subscriber = handle_.subscribe<sensor_msgs::PointCloud2>(
      "alone/mav/dense_cloud", 10, [&](const sensor_msgs::PointCloud2::ConstPtr&) { ++clouds; });
  ASSERT_TRUE(spinUntil([&] { return images.getNumSubscribers() > 0 && subscriber.getNumPublishers() > 0; }));
  // Each flight is too short for a cloud of its own accord; one that stops halfway for longer than the node waits gives
  // none.
  for (int attempt = 0; attempt < 5 && clouds == 0; ++attempt) {
    for (int i = 0; i < kFrames; ++i) images.publish(message(i, 700 + 10 * attempt, 1));
    spinUntil([&] { return clouds > 0; });
  }
  EXPECT_GT(clouds, 0);
}

TEST_F(DenseFusionNodeTest, SaysThatItIsBehind) {
  bool said = false;  // once a second: a fast machine may be done before
  for (double start = 2000; start < 4000 && !said; start += 100) {
    for (int i = 0; i < kFrames; ++i) send(message(i, start, 1));
    for (int i = 0; i < 2; ++i) send(message(i, start + 60, 1));
    // The lag is of the image that is being worked on, the state of the one before: at the end of a flight they differ.
    said = spinUntil(
        [&] { return diagnostics_.message().find("too slow: ") == 0 && diagnostics_.counted("lag [s]") > 10; }, 600);
  }
  EXPECT_TRUE(said) << diagnostics_.message();
  EXPECT_EQ(diagnostics_.level(), diagnostic_msgs::DiagnosticStatus::WARN);
}

// Twenty seconds that nobody works on.
TEST(WorkQueue, ImagesFarBehindMakeRoomForNewOnes) {
  ros_utils::NodeHealth health("work_queue");
  for (const double max_latency : {5.0, 0.0}) {
    dense_fusion::WorkQueue queue(400, max_latency, health);
    air_ground::PosedImage image;
    for (int i = 0; i < 200; ++i) {
      image.header.stamp.fromSec(100 + 0.1 * i);
      queue.add(boost::make_shared<const air_ground::PosedImage>(image));
    }
    EXPECT_EQ(queue.imagesWaiting(), max_latency > 0 ? 51u : 200u);
    const auto work = queue.next();
    ASSERT_TRUE(work && work->image);
    EXPECT_NEAR(queue.lag(work->image->header.stamp), max_latency > 0 ? 5 : 19.9, 1e-6);
  }
}

// In a map without scale the cells are a share of the scene's distance, which a landing makes small.
TEST(MapStore, WhatIsSeenFromNearerIsKeptFiner) {
  const dense_fusion::NodeSettings settings;
  ros_utils::NodeHealth health("map_store");
  dense_fusion::MapStore store(settings, health);
  const auto level = [](double step, float z) {
    std::vector<dense_fusion::SurfacePoint> points;
    for (int i = 0; i < 50 * 50; ++i) {
      dense_fusion::SurfacePoint p;
      p.position = {static_cast<float>(step * (i % 50 + 0.5)), static_cast<float>(step * (i / 50 + 0.5)), z};
      points.push_back(p);
    }
    return points;
  };
  store.followUnit(0.05);
  store.add(1, level(settings.map_cell, 0));
  EXPECT_EQ(store.asPublished(0, 9)->second.size(), 2500u) << "whole until there is time to thin it";
  store.thin();
  EXPECT_LT(store.size(), 20u);
  store.followUnit(1);
  store.add(2, level(settings.map_cell, 1));
  store.thin();
  store.followUnit(0.05);
  store.add(3, level(settings.map_cell, 2));
  store.thin();
  EXPECT_GE(store.size(), 2500u);
  EXPECT_LT(store.size(), 2540u);
}

// A slow disk: a file that cannot be opened until somebody writes into it.
TEST(MapStore, PointsComeInWhileItWrites) {
  const dense_fusion::NodeSettings settings;
  ros_utils::NodeHealth health("map_store");
  dense_fusion::MapStore store(settings, health);
  store.add(1, {{{1, 2, 3}, {0, 0, 1}, 9, 1}});
  const std::string pipe = "/tmp/map_store_" + std::to_string(getpid()) + ".ply";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  auto written = std::async(std::launch::async, [&] {
    EXPECT_THROW(store.write(pipe), std::runtime_error);  // in the end: it is no map
  });
  EXPECT_EQ(written.wait_for(std::chrono::milliseconds(300)), std::future_status::timeout);
  auto added = std::async(std::launch::async, [&] { store.add(2, {{{4, 5, 6}, {0, 0, 1}, 9, 1}}); });
  EXPECT_EQ(added.wait_for(std::chrono::seconds(5)), std::future_status::ready);
  std::ofstream(pipe) << "not a map";
  written.wait();
  added.wait();
  EXPECT_EQ(store.size(), 2u);
  std::remove(pipe.c_str());
}

// What was reconstructed lies where the map's correction puts it, in the file, too.
TEST_F(DenseFusionNodeTest, CloudsFollowACorrectionOfTheMap) {
  std::vector<air_ground::CloudCorrections::ConstPtr> corrections;
  const auto subscriber = handle_.subscribe<air_ground::CloudCorrections>(
      "mav/cloud_corrections", 10, [&](const air_ground::CloudCorrections::ConstPtr& m) { corrections.push_back(m); });
  auto publisher = handle_.advertise<nav_msgs::Path>("mav/corrected_path", 10);
  ASSERT_TRUE(spinUntil([&] { return publisher.getNumSubscribers() > 0 && subscriber.getNumPublishers() > 0; }));
  fly(1000, 1);
  flushToCloud(1000);
  const auto heights = [&] {
    air_ground::SaveMap save;
    save.request.path = std::string(P_tmpdir) + "/dense_fusion_correction.ply";
    EXPECT_TRUE(ros_utils::callService("dense_fusion/save_map", save));
    std::vector<float> z;
    for (const auto& p : air_ground_common::readPlyPoints(save.request.path)) z.push_back(p.position.z());
    std::remove(save.request.path.c_str());
    return z;
  };
  const float before = air_ground_common::median(heights());

  const nav_msgs::Path path = correctedPath(1000, 0.5);
  nav_msgs::Path other = path;
  other.header.frame_id = "mav_visual_map";
  publisher.publish(other);  // of another map
  publisher.publish(path);
  ASSERT_TRUE(spinUntil([&] { return !corrections.empty(); }));
  ASSERT_EQ(corrections.size(), 1u);
  const auto& msg = *corrections.back();
  EXPECT_EQ(msg.header.frame_id, "mav_map");
  EXPECT_EQ(msg.map_id, 1u);
  ASSERT_EQ(msg.stamps.size(), 1u);
  EXPECT_EQ(msg.stamps[0], clouds_.back()->header.stamp);
  EXPECT_NEAR(msg.scales[0], 1, 1e-3);
  EXPECT_NEAR(msg.poses[0].position.z, 0.5, 1e-3);
  EXPECT_NEAR(air_ground_common::median(heights()), before + 0.5f, 0.01f);
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "dense_fusion_node_test");
  ::testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
