// What the tracker says of itself in /diagnostics and on the console.
#pragma once

#include <ros/ros.h>

#include <cstddef>
#include <optional>
#include <string>

#include "air_ground_common/ros/health.h"
#include "ekf_tracker/tracker.h"

namespace ekf_tracker {

class TrackerState {
 public:
  explicit TrackerState(air_ground_common::ros_utils::NodeHealth& health) : health_(health) {}

  void fixHeard() { ++fixes_heard_; }
  void fixUsed(double stamp) { last_fix_ = std::max(last_fix_, stamp); }
  void odometryUsed();
  /// An increment came that is stamped so far ahead of the clock that it cannot be used [s].
  void odometryAhead(double seconds);
  /// A GPS position so far off the pose was refused [m].
  void gpsRefused(double metres);
  /// One was taken, or the pose is another.
  void gpsAgrees() { gps_refused_ = 0; }

  /// There is odometry, but no pose yet.
  void unlocated(double stamp, bool metric, const ros::Subscriber& fixes);
  void tracking(const PoseEstimate& estimate, double stamp, bool doubtful);
  /// What was said last must not stand when the odometry on `topic` has died.
  void watch(const std::string& topic);
  void forget();

 private:
  air_ground_common::ros_utils::NodeHealth& health_;
  std::optional<double> used_;  ///< when an increment was, by the clock that the messages follow [s]
  bool lost_ = false;
  std::optional<double> unlocated_since_;  ///< [s]
  double last_fix_ = 0;                    ///< stamp of the last one fused [s]
  std::size_t fixes_heard_ = 0;
  int gps_refused_ = 0;  ///< in a row
  double gps_off_ = 0;   ///< the last of these [m]
};

}  // namespace ekf_tracker
