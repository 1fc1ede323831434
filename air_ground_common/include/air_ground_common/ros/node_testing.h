// What the tests of the nodes share. Topics have no order between them, and on a busy machine any process may stand
// still for seconds. So tests wait in turns, and publish what must come after something else when the node has shown
// that it has that: by an output, a service's answer or its diagnostics.
#pragma once

#include <diagnostic_msgs/DiagnosticArray.h>
#include <ros/ros.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <map>
#include <string>

namespace air_ground_common::ros_utils {

/// Turns in which what is waited for must come; more of them where a sanitizer slows the programs down.
inline int patience() {
  const char* slower = std::getenv("AIR_GROUND_SLOWER");
  return 6000 * std::max(1, slower ? std::atoi(slower) : 1);
}

/// Handles callbacks until `done`. False after so many turns of 5 ms: a machine that stands still must not count as
/// waiting.
inline bool spinUntil(const std::function<bool()>& done, int turns = patience()) {
  for (int i = 0; ros::ok() && i < turns; ++i) {
    ros::spinOnce();
    if (done()) return true;
    ros::WallDuration(0.005).sleep();
  }
  return false;
}

/// Handles callbacks for so many turns of 5 ms.
inline void pause(int turns) {
  spinUntil([] { return false; }, turns);
}

/// Calls a service that may be called twice; false when it does not come up or answer. A call's connection can break,
/// and the call fail, when a process stands still meanwhile.
template <typename Service>
bool callService(const std::string& name, Service& service) {
  for (int i = 0; i < 5; ++i) {
    if (ros::service::waitForService(name, ros::Duration(60)) && ros::service::call(name, service)) return true;
    ros::WallDuration(0.1).sleep();
  }
  return false;
}

/// What a node last said on /diagnostics; it does so once a second.
class NodeDiagnostics {
 public:
  /// `node`: its name without the leading slash, e.g. "mav_vo".
  explicit NodeDiagnostics(const std::string& node) : name_(node + ": state") {
    subscriber_ = ros::NodeHandle().subscribe<diagnostic_msgs::DiagnosticArray>(
        "/diagnostics", 100, [this](const diagnostic_msgs::DiagnosticArray::ConstPtr& m) {
          for (const auto& status : m->status) {
            if (status.name != name_) continue;
            stamp_ = m->header.stamp;
            level_ = status.level;
            message_ = status.message;
            values_.clear();
            for (const auto& value : status.values) values_[value.key] = value.value;
          }
        });
  }
  NodeDiagnostics(const NodeDiagnostics&) = delete;
  NodeDiagnostics& operator=(const NodeDiagnostics&) = delete;

  /// Sum of the counters whose names begin so.
  int counted(const std::string& event) const {
    int times = 0;
    for (auto it = values_.lower_bound(event); it != values_.end() && it->first.rfind(event, 0) == 0; ++it)
      times += std::atoi(it->second.c_str());
    return times;
  }
  /// The last message of an expected input that the node has handled has this stamp; `topic`: resolved.
  bool received(const std::string& topic, const ros::Time& stamp) const {
    const auto it = values_.find(topic + " last stamp [s]");
    return it != values_.end() && std::abs(std::atof(it->second.c_str()) - stamp.toSec()) < 1e-3;
  }
  const std::string& message() const { return message_; }
  int level() const { return level_; }
  /// When this was said, by the node's clock.
  const ros::Time& stamp() const { return stamp_; }

  /// Waits for what the node says of now.
  bool refresh() const {
    const ros::Time now = ros::Time::now();
    return spinUntil([&] { return stamp_ > now; });
  }
  /// Waits until the event has been counted so often.
  bool await(const std::string& event, int times) const {
    return spinUntil([&] { return counted(event) >= times; });
  }
  /// Waits until the node has handled the message of this stamp as the last of an expected input.
  bool awaitReceived(const std::string& topic, const ros::Time& stamp) const {
    return spinUntil([&] { return received(topic, stamp); });
  }

 private:
  std::string name_, message_;
  int level_ = -1;
  ros::Time stamp_;
  std::map<std::string, std::string> values_;
  ros::Subscriber subscriber_;
};

}  // namespace air_ground_common::ros_utils
