// Who subscribes late gets what is kept; who was there gets nothing twice.
#include <air_ground/CloudCorrections.h>
#include <nav_msgs/Path.h>

#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>

#include "../src/ros/cloud_publisher.h"
#include "air_ground_common/statistics.h"
#include "flight_fixture.h"

namespace {

namespace ros_utils = air_ground_common::ros_utils;
using ros_utils::spinUntil;
using Clouds = std::vector<sensor_msgs::PointCloud2::ConstPtr>;

std::vector<std::uint64_t> stampsOf(const Clouds& clouds) {
  std::vector<std::uint64_t> stamps;
  for (const auto& cloud : clouds) stamps.push_back(cloud->header.stamp.toNSec());
  return stamps;
}

float medianHeight(const sensor_msgs::PointCloud2& cloud) {
  std::size_t dropped = 0;
  std::vector<float> z;
  for (const auto& p : ros_utils::cloudFromMsg(cloud, &dropped)) z.push_back(p.position.z());
  return air_ground_common::median(z);
}

// Another process: prints stamp and points of so many clouds, and of those that come beyond.
int listen(int clouds) {
  ros::NodeHandle handle;
  int heard = 0;
  const auto subscriber = handle.subscribe<sensor_msgs::PointCloud2>(
      "mav/dense_cloud", 100, [&](const sensor_msgs::PointCloud2::ConstPtr& cloud) {
        ++heard;
        std::cout << cloud->header.stamp.toNSec() << ' ' << cloud->width * cloud->height << std::endl;
      });
  spinUntil([&] { return heard >= clouds; });
  ros_utils::pause(100);
  return 0;
}

// Stamps and points that such a process prints.
std::vector<std::pair<std::uint64_t, std::size_t>> heardBy(int clouds) {
  const std::string command =
      std::filesystem::read_symlink("/proc/self/exe").string() + " listen " + std::to_string(clouds);
  const std::unique_ptr<FILE, int (*)(FILE*)> out(popen(command.c_str(), "r"), pclose);
  std::vector<std::pair<std::uint64_t, std::size_t>> heard;
  unsigned long long stamp = 0, points = 0;
  while (std::fscanf(out.get(), "%llu %llu", &stamp, &points) == 2) heard.emplace_back(stamp, points);
  return heard;
}

class LateSubscriberTest : public dense_fusion::testing::FlightTest {
 protected:
  // Of a subscriber that was not there before.
  void subscribeAnew() {
    cloud_subscriber_.shutdown();
    depth_subscriber_.shutdown();
    clouds_.clear();
    subscribe();
  }
};

TEST_F(LateSubscriberTest, GetsWhatIsKept) {
  fly(100, 1);
  flushToCloud(100);
  fly(110, 1);
  flushToCloud(110);
  const Clouds early = clouds_;
  ASSERT_GE(early.size(), 2u);
  for (std::size_t i = 1; i < early.size(); ++i) EXPECT_LT(early[i - 1]->header.stamp, early[i]->header.stamp);

  const auto heard = heardBy(static_cast<int>(early.size()));
  ASSERT_EQ(heard.size(), early.size());
  for (std::size_t i = 0; i < early.size(); ++i) {
    EXPECT_EQ(heard[i].first, early[i]->header.stamp.toNSec());
    EXPECT_GT(heard[i].second, early[i]->width / 3) << "thinned, but not to nothing";
    EXPECT_LE(heard[i].second, early[i]->width);
  }
  ros_utils::pause(20);
  EXPECT_EQ(stampsOf(clouds_), stampsOf(early)) << "who was there got some twice";
}

// Corrections count since a cloud was published: it must come as it was then.
TEST_F(LateSubscriberTest, GetsCorrectionsToo) {
  auto publisher = handle_.advertise<nav_msgs::Path>("mav/corrected_path", 10);
  std::vector<air_ground::CloudCorrections::ConstPtr> corrections;
  const auto subscribeToCorrections = [&] {
    return handle_.subscribe<air_ground::CloudCorrections>(
        "mav/cloud_corrections", 10,
        [&](const air_ground::CloudCorrections::ConstPtr& m) { corrections.push_back(m); });
  };
  auto subscriber = subscribeToCorrections();
  ASSERT_TRUE(spinUntil([&] { return publisher.getNumSubscribers() > 0 && subscriber.getNumPublishers() > 0; }));
  fly(300, 1);
  flushToCloud(300);
  const auto early = clouds_.back();
  publisher.publish(correctedPath(300, 0.5));
  ASSERT_TRUE(spinUntil([&] { return !corrections.empty(); }));

  subscriber.shutdown();
  corrections.clear();
  subscriber = subscribeToCorrections();
  subscribeAnew();
  ASSERT_TRUE(spinUntil([&] { return !clouds_.empty() && !corrections.empty(); }));
  EXPECT_EQ(clouds_.back()->header.stamp, early->header.stamp);
  EXPECT_EQ(clouds_.back()->header.frame_id, "mav_map");
  EXPECT_NEAR(medianHeight(*clouds_.back()), medianHeight(*early), 0.02);
  ASSERT_EQ(corrections.back()->stamps.size(), 1u);
  EXPECT_EQ(corrections.back()->stamps[0], early->header.stamp);
  EXPECT_NEAR(corrections.back()->poses[0].position.z, 0.5, 1e-3);
  EXPECT_EQ(corrections.back()->map_id, 1u);
}

TEST_F(LateSubscriberTest, GetsNothingOfAMapThatHasEnded) {
  fly(400, 1);
  flushToCloud(400);
  auto next = message(0, 410, 2);
  next.metric = false;  // no image of it is fused so far
  send(next);
  ASSERT_TRUE(taken(next));
  std_srvs::Trigger trigger;  // answered when the worker has seen the image
  ASSERT_TRUE(ros_utils::callService("dense_fusion/flush", trigger));
  subscribeAnew();
  ros_utils::pause(100);
  EXPECT_TRUE(clouds_.empty());
}

// More than a connection holds, and a new cloud while they are sent.
TEST(CloudPublisher, SendsManyInTheirOrder) {
  constexpr std::size_t kClouds = 60;
  ros::NodeHandle handle("order");
  const dense_fusion::NodeSettings settings;
  ros_utils::NodeHealth health("order");
  dense_fusion::MapStore map(settings, health);
  dense_fusion::WorkQueue queue(10, 0, health);
  dense_fusion::CloudPublisher publisher(handle, map, queue, health);
  const auto publish = [&](std::size_t second) {
    auto cloud = boost::make_shared<sensor_msgs::PointCloud2>();
    cloud->header.stamp.sec = static_cast<std::uint32_t>(second);
    cloud->header.frame_id = "mav_map";
    map.add(static_cast<std::int64_t>(cloud->header.stamp.toNSec()), {{{1, 2, 3}, {0, 0, 1}, 9, 1}});
    queue.unlessReset([&] { publisher.publish(cloud); });
  };
  for (std::size_t i = 1; i <= kClouds; ++i) publish(i);

  std::vector<std::size_t> seconds;
  const auto subscriber = handle.subscribe<sensor_msgs::PointCloud2>(
      "mav/dense_cloud", 100,
      [&](const sensor_msgs::PointCloud2::ConstPtr& cloud) { seconds.push_back(cloud->header.stamp.sec); });
  ASSERT_TRUE(spinUntil([&] { return seconds.size() > 2; }));
  publish(kClouds + 1);
  ASSERT_TRUE(spinUntil([&] { return seconds.size() > kClouds; }));
  ros_utils::pause(20);
  ASSERT_EQ(seconds.size(), kClouds + 1);
  for (std::size_t i = 0; i < seconds.size(); ++i) EXPECT_EQ(seconds[i], i + 1);
}

}  // namespace

int main(int argc, char** argv) {
  const bool listens = argc > 2 && std::string(argv[1]) == "listen";
  ros::init(argc, argv, "late_subscriber_test", listens ? ros::init_options::AnonymousName : 0);
  if (listens) return listen(std::stoi(argv[2]));
  ::testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
