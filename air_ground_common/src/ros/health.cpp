#include "air_ground_common/ros/health.h"

#include <ros/master.h>

#include <algorithm>
#include <sstream>

namespace air_ground_common::ros_utils {

NodeHealth::NodeHealth(const std::string& hardware_id) : started_(ros::WallTime::now()), watched_(started_) {
  updater_.setHardwareID(hardware_id);
  updater_.add("state", this, &NodeHealth::report);
  // A wall timer: diagnostics and warnings must come when /clock stands still, too.
  timer_ = ros::NodeHandle().createWallTimer(ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) {
    watch();
    updater_.force_update();
  });
}

void NodeHealth::expectInput(const std::string& topic, bool continuous) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Input& input = inputs_[topic];
  input.last_arrival = ros::WallTime::now();
  input.continuous = continuous;
}

void NodeHealth::received(const std::string& topic, const ros::Time& stamp) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Input& input = inputs_[topic];
  ++input.messages;
  input.last_stamp = stamp;
  input.last_arrival = ros::WallTime::now();
  input.warned = false;
}

void NodeHealth::count(const std::string& event, std::size_t times) {
  if (times == 0) return;
  bool first;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::size_t& counter = counters_[event];
    first = counter == 0;
    counter += times;
  }
  if (first) ROS_WARN_STREAM(event << " (said once; counted in /diagnostics)");
}

std::size_t NodeHealth::counted(const std::string& event) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto it = counters_.find(event);
  return it == counters_.end() ? 0 : it->second;
}

void NodeHealth::timing(const std::string& step, double seconds) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Timing& t = timings_[step];
  ++t.runs;
  t.sum += seconds;
  t.max = std::max(t.max, seconds);
}

void NodeHealth::state(int level, const std::string& line) {
  const std::lock_guard<std::mutex> lock(mutex_);
  level_ = level;
  line_ = line;
}

void NodeHealth::watch() {
  std::vector<std::pair<std::string, Input>> silent;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const ros::WallTime now = ros::WallTime::now();
    const ros::Time clock = ros::Time::now();
    const bool paused = ros::Time::isSimTime() && clock == clock_;
    for (auto& [topic, input] : inputs_) {
      if (paused && input.messages > 0) input.last_arrival += now - watched_;
      if (!input.continuous && input.messages > 0) continue;
      if (input.warned || (now - input.last_arrival).toSec() < 3.0) continue;
      input.warned = true;
      silent.emplace_back(topic, input);
    }
    watched_ = now;
    clock_ = clock;
  }
  if (silent.empty()) return;
  ros::master::V_TopicInfo published;
  ros::master::getTopics(published);
  for (const auto& [topic, input] : silent) {
    const bool advertised = std::any_of(published.begin(), published.end(),
                                        [&t = topic](const ros::master::TopicInfo& info) { return info.name == t; });
    std::ostringstream line;
    line << "nothing on " << topic << " for 3 s: " << (advertised ? "it is advertised, but no message comes" : "nobody publishes it (is a remapping or a namespace wrong?)");
    if (input.messages > 0) line << "; the last of " << input.messages << " messages has the stamp " << input.last_stamp;
    ROS_WARN_STREAM(line.str());
  }
}

void NodeHealth::report(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  status.summary(static_cast<unsigned char>(level_), line_);
  const double alive = (ros::WallTime::now() - started_).toSec();
  for (const auto& [topic, input] : inputs_) {
    status.addf(topic + " messages", "%zu", input.messages);
    status.addf(topic + " mean rate [Hz]", "%.2f", alive > 0 ? input.messages / alive : 0.0);
    status.addf(topic + " last stamp [s]", "%.3f", input.last_stamp.toSec());
  }
  for (const auto& [step, t] : timings_) {
    status.addf(step + " mean [ms]", "%.2f", 1e3 * t.sum / t.runs);
    status.addf(step + " max [ms]", "%.2f", 1e3 * t.max);
  }
  for (const auto& [event, times] : counters_) status.addf(event, "%zu", times);
}

bool TimeJumpDetector::jumped(const ros::Time& stamp) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!newest_.isZero() && stamp + ros::Duration(tolerance_) < newest_) {
    newest_ = stamp;
    return true;
  }
  newest_ = std::max(newest_, stamp);
  return false;
}

StreamJumpDetector::Verdict StreamJumpDetector::watch(std::size_t index, const ros::Time& stamp, const ros::WallTime& now) {
  Stream& stream = streams_.at(index);
  const bool back = !stream.newest.isZero() && stamp + ros::Duration(tolerance_) < stream.newest;
  Verdict verdict = Verdict::kInOrder;
  if (stream.pass == pass_ && back) {
    // Halfway between the passes lies what tells the old one from the new one on streams that have yet to follow.
    ceiling_ = stamp + (newest_ - stamp) * 0.5;
    stream.pass = ++pass_;
    newest_ = stamp;
    jumped_ = now;
    verdict = Verdict::kJump;
  } else if (stream.pass != pass_) {
    if (!back && stamp > ceiling_ && (now - jumped_).toSec() < patience_) return Verdict::kOld;
    stream.pass = pass_;
    stream.newest = stamp;
  }
  stream.newest = verdict == Verdict::kJump ? stamp : std::max(stream.newest, stamp);
  newest_ = std::max(newest_, stamp);
  return verdict;
}

}  // namespace air_ground_common::ros_utils
