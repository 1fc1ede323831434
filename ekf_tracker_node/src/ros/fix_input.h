// Street-level fixes, and which panorama each rests on.
#pragma once

#include <air_ground/StreetviewMatch.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <ros/ros.h>

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <string>

#include "air_ground_common/ros/health.h"
#include "sensor_bridge.h"

namespace ekf_tracker {

/// Subscribes to streetview/pose and streetview/match, whose messages belong together by their stamps. A fix waits for
/// its match where somebody publishes matches; without, its panorama is not known. Callbacks of one thread.
class FixInput {
 public:
  using Message = geometry_msgs::PoseWithCovarianceStamped;

  /// `on_message`: of each fix, as it comes; `on_attitude`: likewise, of those in the world's frame; `on_fix`: when it
  /// can be used. What is given must outlive this.
  FixInput(ros::NodeHandle handle, const NodeSettings& settings, const SensorBridge& bridge,
           air_ground_common::ros_utils::NodeHealth& health, std::function<void()> on_message,
           std::function<void(const Message&)> on_attitude, std::function<void(const Measurement&)> on_fix);

  /// Hands on the fixes that need not wait any longer.
  void drain();
  void clear();
  const ros::Subscriber& subscriber() const { return fixes_; }

 private:
  struct Pending {
    Measurement fix;
    std::uint64_t stamp = 0;  ///< [ns]
    double received = 0;      ///< by a clock that nobody sets [s]
  };

  void onFix(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg);
  void onMatch(const air_ground::StreetviewMatch::ConstPtr& msg);

  const NodeSettings& settings_;
  const SensorBridge& bridge_;
  air_ground_common::ros_utils::NodeHealth& health_;
  const std::function<void()> on_message_;
  const std::function<void(const Message&)> on_attitude_;
  const std::function<void(const Measurement&)> on_fix_;
  std::deque<Pending> pending_;
  std::map<std::uint64_t, unsigned> place_at_;  ///< by stamp [ns]; of the newest matches
  std::map<std::string, unsigned> number_of_;   ///< of panoramas, from 1
  ros::Subscriber fixes_, matches_;
};

}  // namespace ekf_tracker
