// Where an estimator's node begins to number its maps.
#pragma once

#include <ros/node_handle.h>
#include <ros/time.h>

#include <cstdint>
#include <limits>
#include <random>

#include "air_ground_common/ros/parameters.h"

namespace air_ground_common::ros_utils {

constexpr std::uint32_t kMapsOfOneStart = 10000;

/// What the ids of this start's maps are counted from: neighbours must not take a new map for one that they know. Drawn
/// by lot, one of 429496: after a power cycle neither the master remembers earlier starts nor, without a battery, the
/// clock. In a replay, which is to give the same ids each time, the starts are counted under the master: 0, then 1.
inline std::uint32_t mapIdOffset(const ros::NodeHandle& private_handle) {
  if (!ros::Time::isSimTime())
    return kMapsOfOneStart * (std::random_device{}() % (std::numeric_limits<std::uint32_t>::max() / kMapsOfOneStart));
  const int starts = private_handle.param(kStartsParameter, 0);
  private_handle.setParam(kStartsParameter, starts + 1);
  return kMapsOfOneStart * static_cast<std::uint32_t>(starts);
}

}  // namespace air_ground_common::ros_utils
