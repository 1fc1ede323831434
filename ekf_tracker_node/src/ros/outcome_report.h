// What became of measurements and increments: published, and counted by name.
#pragma once

#include "air_ground_common/ros/health.h"
#include "ekf_tracker/tracker.h"
#include "tracked_pose_publisher.h"
#include "tracker_state.h"

namespace ekf_tracker {

class OutcomeReport {
 public:
  OutcomeReport(Tracker& tracker, TrackedPosePublisher& publisher, TrackerState& state,
                air_ground_common::ros_utils::NodeHealth& health)
      : tracker_(tracker), publisher_(publisher), state_(state), health_(health) {}

  /// All that the tracker has ready.
  void publishPending();
  void publish(const Outcome& outcome);
  /// False: the increment was not used.
  bool count(IncrementResult result);
  void reset() { recoveries_ = 0; }

 private:
  Tracker& tracker_;
  TrackedPosePublisher& publisher_;
  TrackerState& state_;
  air_ground_common::ros_utils::NodeHealth& health_;
  int recoveries_ = 0;
};

}  // namespace ekf_tracker
