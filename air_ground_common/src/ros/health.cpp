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
    line << "nothing on " << topic << " for 3 s: "
         << (advertised ? "it is advertised, but no message comes"
                        : "nobody publishes it (is a remapping or a namespace wrong?)");
    if (input.messages > 0)
      line << "; the last of " << input.messages << " messages has the stamp " << input.last_stamp;
    ROS_WARN_STREAM(line.str());
  }
}

void NodeHealth::report(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  status.summary(static_cast<unsigned char>(level_), line_);
  for (const auto& [topic, input] : inputs_)
    if (input.warned && input.messages > 0)
      status.summaryf(diagnostic_msgs::DiagnosticStatus::ERROR, "%s; nothing on %s for %.0f s",
                      std::string(status.message).c_str(), topic.c_str(),
                      (ros::WallTime::now() - input.last_arrival).toSec());
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
  const double t = stamp.toSec();
  const bool back = t + tolerance_ < newest_;
  newest_ = back ? t : std::max(newest_, t);
  return back;
}

bool StreamJumpDetector::hold(Stream* stream, double t) const {
  constexpr double kFast = 0.5;  // [s] between messages; a slow stream's single message is too precious to hold
  const double leap = std::max(tolerance_, 20 * stream->interval);
  const bool confirmed = stream->held >= 0 && t > stream->held - tolerance_ && t < stream->held + leap;
  stream->held = -1;
  if (confirmed || stream->messages < 10 || stream->interval > kFast) return false;
  if (t > stream->newest - tolerance_ && t < stream->newest + leap) return false;
  stream->held = t;
  return true;
}

StreamJumpDetector::Verdict StreamJumpDetector::watch(std::size_t index, const ros::Time& stamp,
                                                      const ros::WallTime& now) {
  Stream& stream = streams_.at(index);
  if (stamp.isZero()) return Verdict::kOld;
  const double t = stamp.toSec();
  const bool back = t + tolerance_ < stream.newest;
  Verdict verdict = Verdict::kInOrder;
  if (stream.pass == pass_) {
    if (hold(&stream, t)) return Verdict::kOld;
    if (back) {
      // Halfway between the passes lies what tells the old one from the new one on streams that have yet to follow.
      ceiling_ = t + (newest_ - t) * 0.5;
      old_newest_ = newest_;
      stream.pass = ++pass_;
      newest_ = t;
      jumped_ = now;
      verdict = Verdict::kJump;
    }
  } else {
    constexpr double kAhead = 0.1;  // [s] of one stream before the others
    if (!back && t > ceiling_ && t < old_newest_ + kAhead && (now - jumped_).toSec() < patience_) return Verdict::kOld;
    stream.pass = pass_;
    stream.newest = t;
  }
  if (stream.newest >= 0 && t > stream.newest) {
    const double interval = t - stream.newest;
    stream.interval += (interval - stream.interval) / std::min<std::size_t>(++stream.messages, 50);
  }
  stream.newest = verdict == Verdict::kJump ? t : std::max(stream.newest, t);
  newest_ = std::max(newest_, t);
  return verdict;
}

bool StreamGate::admit(std::size_t stream, const ros::Time& stamp) {
  const StreamJumpDetector::Verdict verdict = jumps_.watch(stream, stamp);
  if (verdict == StreamJumpDetector::Verdict::kOld) {
    health_.count("messages of the time before a jump dropped");
    return false;
  }
  if (verdict == StreamJumpDetector::Verdict::kJump) start_afresh_();
  return true;
}

}  // namespace air_ground_common::ros_utils
