#include "ended_maps.h"

#include <ros/console.h>

#include <utility>

#include "air_ground_common/ros/file_services.h"
#include "cloud_publisher.h"

namespace rgbd_slam {

void EndedMaps::add(std::uint32_t map_id, const EndedMap& map) {
  constexpr std::size_t kWorthIt = 20;  // poses
  if (map.trajectory.size() < kWorthIt) return;
  constexpr std::size_t kMost = 20;  // maps
  kept_.push_back({map.trajectory, "", map_id});
  if (kept_.size() > kMost) kept_.erase(kept_.begin());
  ROS_WARN("map %u has ended after %zu poses: %s", map_id, map.trajectory.size(),
           autosave_.on()
               ? "it is saved in the folder autosave"
               : "its cloud is lost, and after a reset its trajectory too (parameter autosave: a folder for such)");
  if (!autosave_.on()) return;
  // The one before is waited for there: to let go of its future would wait for it here.
  writing_ =
      std::async(std::launch::async, [this, map, before = std::move(writing_), name = "map" + std::to_string(map_id)] {
        if (before.valid()) before.wait();
        autosave_.save("trajectory_" + name + ".txt",
                       [&](const std::string& path) { air_ground_common::writeTum(path, map.trajectory); });
        autosave_.save(name + ".ply", [&](const std::string& path) {
          air_ground_common::ros_utils::writeCloud(path, cloudForFile(map.points, cloud_));
        });
      });
}

}  // namespace rgbd_slam
