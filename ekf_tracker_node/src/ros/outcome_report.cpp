#include "outcome_report.h"

#include <ros/console.h>

#include <string>

#include "sensor_bridge.h"

namespace ekf_tracker {

void OutcomeReport::publishPending() {
  for (const Outcome& o : tracker_.popOutcomes()) publish(o);
  if (tracker_.filter().recoveries() > recoveries_) {
    ROS_WARN("fixes that agree with each other contradicted the tracked pose: it was wrong and has been replaced");
    health_.count("recoveries from a wrong pose");
  }
  recoveries_ = tracker_.filter().recoveries();
}

void OutcomeReport::publish(const Outcome& o) {
  const Source source = o.measurement.source;
  if (source == Source::kFix && isUsed(o.result)) state_.fixUsed(o.measurement.stamp);
  if (o.result == Result::kRecovered || o.result == Result::kInitialised ||
      (source == Source::kGps && isUsed(o.result)))
    state_.gpsAgrees();
  else if (source == Source::kGps && o.result == Result::kRefusedByGate && !o.revised)
    state_.gpsRefused(o.innovation.head<3>().norm());
  // Refusals are counted by name; waiting for a partner is none.
  const bool waits = o.result == Result::kWaiting || o.result == Result::kNotStarted;
  if (o.revised)
    health_.count("results of earlier measurements revised by later ones");
  else if (o.result == Result::kRecovered || (!isUsed(o.result) && !waits))
    health_.count(std::string(nameOf(source)) + ": " + describe(o.result));
  if (o.result == Result::kInitialised) ROS_INFO("fixes that agree start the tracker, or bring it back after a gap");
  publisher_.publish(o, tracker_);
}

bool OutcomeReport::count(IncrementResult result) {
  switch (result) {
    case IncrementResult::kUsed:
      return true;
    case IncrementResult::kUsedAfterGap:
      health_.count("gaps in the odometry, bridged");
      return true;
    case IncrementResult::kNewUnit:
      health_.count(
          "odometry began a new map in an unknown unit: only its turns are used until two fixes give the scale");
      return true;
    case IncrementResult::kOutOfOrder:
      health_.count("increments ignored: out of order or repeated");
      return false;
    case IncrementResult::kInvalid:
      health_.count("increments ignored: not finite");
      return false;
  }
  return false;
}

}  // namespace ekf_tracker
