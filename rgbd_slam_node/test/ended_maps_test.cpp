// Maps that end while others are still written.
#include "../src/ros/ended_maps.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>

namespace rgbd_slam {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

double since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

/// A map of so many points, each in a voxel of its own.
EndedMap mapOf(int points) {
  EndedMap map;
  map.trajectory.resize(30);
  for (std::size_t i = 0; i < map.trajectory.size(); ++i) map.trajectory[i].stamp = 100 + 0.1 * static_cast<double>(i);
  std::vector<KeyframeDepth::Point> cloud(points);
  for (int i = 0; i < points; ++i) cloud[i] = {Eigen::Vector3f(0.1F * (i % 1000), 0.1F * (i / 1000), 2), {1, 2, 3}, 1};
  map.points.push_back({Pose::Identity(), std::make_shared<const std::vector<KeyframeDepth::Point>>(cloud), 0});
  return map;
}

struct EndedMapsTest : testing::Test {
  EndedMapsTest() : folder(testing::TempDir() + "ended_" + std::to_string(getpid())), autosave(folder) {}
  ~EndedMapsTest() override { fs::remove_all(folder); }
  std::size_t written() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
  }

  const std::string folder;
  const air_ground_common::ros_utils::Autosave autosave;
  const CloudSettings cloud;
};

TEST_F(EndedMapsTest, WhoeverEndsWaitsForNoneThatIsWritten) {
  const EndedMap large = mapOf(150000), small = mapOf(1000);
  double one = 0, add = 0;
  {
    const auto begin = Clock::now();
    EndedMaps(cloud, autosave).add(1, large);  // its end waits
    one = since(begin);
  }
  EXPECT_EQ(written(), 2u);
  {
    EndedMaps maps(cloud, autosave);
    maps.add(2, large);
    const auto begin = Clock::now();
    maps.add(3, small);
    maps.add(4, small);
    add = since(begin);
  }
  EXPECT_LT(add, 0.3 * one) << "to write one takes " << one << " s";
  EXPECT_EQ(written(), 8u) << "all the same each is written";
}

TEST_F(EndedMapsTest, KeepsTheNewestTrajectories) {
  const air_ground_common::ros_utils::Autosave off("");
  EndedMaps maps(cloud, off);
  const EndedMap small = mapOf(10);
  for (std::uint32_t id = 1; id <= 30; ++id) maps.add(id, small);
  std::vector<air_ground_common::ros_utils::MapTrajectory> kept;
  maps.appendTo(&kept);
  ASSERT_EQ(kept.size(), 20u);
  EXPECT_EQ(kept.front().id, 30u);
  EXPECT_EQ(kept.back().id, 11u);
}

}  // namespace
}  // namespace rgbd_slam
