// Maps that the robot goes on without: what was mapped before it was lost, or before it began afresh.
#pragma once

#include <cstdint>
#include <future>
#include <string>
#include <vector>

#include "air_ground_common/ros/estimator_shell.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

/// Their trajectories are kept for the service that saves them. With a folder for it (parameter autosave), trajectory
/// and cloud are written as the map ends: dense points take too much memory to be kept, and power may fail. Not
/// thread-safe.
class EndedMaps {
 public:
  /// `autosave` outlives this.
  EndedMaps(const CloudSettings& cloud, const air_ground_common::ros_utils::Autosave& autosave)
      : cloud_(cloud), autosave_(autosave) {}

  /// Writes on another thread, after the map before it. A map of some frames is none.
  void add(std::uint32_t map_id, const EndedMap& map);
  /// Of those that are kept; what is written stays.
  void forget() { kept_.clear(); }
  /// Appends them, the newest first.
  void appendTo(std::vector<air_ground_common::ros_utils::MapTrajectory>* trajectories) const {
    trajectories->insert(trajectories->end(), kept_.rbegin(), kept_.rend());
  }

 private:
  const CloudSettings cloud_;
  const air_ground_common::ros_utils::Autosave& autosave_;
  std::vector<air_ground_common::ros_utils::MapTrajectory> kept_;
  std::future<void> writing_;  // its destructor waits
};

}  // namespace rgbd_slam
