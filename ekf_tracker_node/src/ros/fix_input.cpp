#include "fix_input.h"

#include <utility>

namespace ekf_tracker {
namespace {

constexpr std::size_t kMostMatches = 1000;  // kept for fixes to come

// Of a clock that nobody sets [s].
double steadySeconds() { return ros::SteadyTime::now().toSec(); }

}  // namespace

FixInput::FixInput(ros::NodeHandle handle, const NodeSettings& settings, const SensorBridge& bridge,
                   air_ground_common::ros_utils::NodeHealth& health, std::function<void()> on_message,
                   std::function<void(const Message&)> on_attitude, std::function<void(const Measurement&)> on_fix)
    : settings_(settings),
      bridge_(bridge),
      health_(health),
      on_message_(std::move(on_message)),
      on_attitude_(std::move(on_attitude)),
      on_fix_(std::move(on_fix)) {
  matches_ = handle.subscribe("streetview/match", 100, &FixInput::onMatch, this);
  fixes_ = handle.subscribe("streetview/pose", 100, &FixInput::onFix, this);
}

void FixInput::onFix(const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& msg) {
  on_message_();
  if (msg->header.frame_id != settings_.world_frame)
    return health_.count("fixes ignored: in frame '" + msg->header.frame_id + "', expected '" + settings_.world_frame +
                         "'");
  on_attitude_(*msg);
  pending_.push_back({bridge_.fix(*msg), msg->header.stamp.toNSec(), steadySeconds()});
  drain();
}

void FixInput::onMatch(const air_ground::StreetviewMatch::ConstPtr& msg) {
  if (msg->status != air_ground::StreetviewMatch::STATUS_ACCEPTED) return;
  unsigned place = 0;
  if (!msg->panorama_id.empty())
    place = number_of_.try_emplace(msg->panorama_id, static_cast<unsigned>(number_of_.size() + 1)).first->second;
  place_at_[msg->header.stamp.toNSec()] = place;
  if (place_at_.size() > kMostMatches) place_at_.erase(place_at_.begin());
  drain();
}

void FixInput::drain() {
  while (!pending_.empty()) {
    Pending next = pending_.front();
    const auto match = place_at_.find(next.stamp);
    if (match != place_at_.end()) {
      next.fix.place = match->second;
    } else if (matches_.getNumPublishers() > 0) {
      if (steadySeconds() - next.received <= air_ground_common::ros_utils::kTopicsInStep) return;
      health_.count("fixes without a " + matches_.getTopic() + " of their stamp: their panorama is not known");
    }
    pending_.pop_front();
    on_fix_(next.fix);
  }
}

void FixInput::clear() {
  pending_.clear();
  place_at_.clear();
}

}  // namespace ekf_tracker
