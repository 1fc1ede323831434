// The thread that keeps and publishes the augmented map: what changes it waits here, so that no pose waits for it.
#pragma once

#include <ros/ros.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/health.h"
#include "icp_refine/augmented_map.h"

namespace icp_refine {

class MapThread {
 public:
  struct Shown {
    AugmentedMap map;
    ros::Time stamp;  ///< of the newest data that its pose rests on
  };
  using Change = std::function<void(Shown&)>;

  /// Published in `frame` once a `period` [s] at most, while somebody subscribes; `health` must outlive this.
  MapThread(const AugmentedMapSettings& settings, const std::string& frame, double period,
            air_ground_common::ros_utils::NodeHealth& health);
  ~MapThread();

  /// Changes are made in the order in which they come. `shows`: where the MAV's points are in the map before or after
  /// it, subscribers get it anew.
  void post(Change change, bool shows);
  /// The map after all changes so far; second: whether the MAV's points are in it.
  std::pair<std::vector<LabeledPoint>, bool> points();

 private:
  using Clock = std::chrono::steady_clock;

  void work();
  bool publishes() const { return due_ && publisher_.getNumSubscribers() > 0; }
  void publish();

  const std::string frame_;
  const Clock::duration period_;
  air_ground_common::ros_utils::NodeHealth& health_;
  Shown shown_;       // the thread's alone, as the next two
  bool due_ = false;  // until there is a subscriber
  Clock::time_point next_;

  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<std::pair<Change, bool>> changes_;
  bool stop_ = false;
  ros::Publisher publisher_;
  std::thread thread_;
};

}  // namespace icp_refine
