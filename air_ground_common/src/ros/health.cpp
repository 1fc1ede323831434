#include "air_ground_common/ros/health.h"

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/master.h>
#include <ros/this_node.h>
#include <xmlrpcpp/XmlRpcException.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <set>
#include <sstream>
#include <thread>

namespace air_ground_common::ros_utils {
namespace {

constexpr double kSilence = 3.0;    // of an input or an output before it is warned of [s, wall clock]
constexpr double kRare = 30.0;      // the same of one that may pause, for it takes a map, or a flight, to make
constexpr double kOpening = 60.0;   // of a bag, for the player to begin, before its topics are missed [s, wall clock]
constexpr double kSayAgain = 60.0;  // a reason for silence [s]
constexpr double kClockless = 5.0;  // messages may come before /clock [s, wall clock]
constexpr double kMasterAnswers = 2.0;  // in this time, or is not waited for [s]
constexpr double kClocksApart = 5.0;    // stamps from this machine's clock [s]; tf keeps ten
constexpr std::size_t kApartInARow = 5;
constexpr std::size_t kMostKinds = 100;

/// /use_sim_time outlives a replay where the master runs on, and leaves live nodes without time. One for the process,
/// as its clock is.
class ClockWatch {
 public:
  static ClockWatch& instance() {
    static ClockWatch watch;
    return watch;
  }
  /// `fed`: messages come, so that no player has yet to begin.
  void watch(const ros::WallTime& now, const ros::Time& clock, bool fed) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ros::Time::isSimTime() || !clock.isZero()) {
      since_ = fed_since_ = ros::WallTime();
      return;
    }
    if (since_.isZero()) since_ = now;
    if (fed && fed_since_.isZero()) fed_since_ = now;
    const bool missed = !fed_since_.isZero() && (now - fed_since_).toSec() >= kClockless;
    if (!missed && (now - since_).toSec() < kOpening) return;
    if (!said_.isZero() && (now - said_).toSec() < kSayAgain) return;
    said_ = now;
    ROS_WARN(
        "/use_sim_time is set, but nothing gives /clock: rosparam set /use_sim_time false and start again, or play "
        "with --clock");
  }

 private:
  std::mutex mutex_;
  ros::WallTime since_, fed_since_, said_;
};

/// This machine's clock minus the stamp [s]; 0 where that tells nothing: in a replay, and of a stamp that was not set.
double behindClock(const ros::Time& stamp) {
  const double t = stamp.toSec();
  return ros::Time::isSimTime() || t == 0 || t > kEndOfStamps ? 0 : ros::Time::now().toSec() - t;
}

}  // namespace

std::string kindOf(const std::string& text) {
  std::string kind;
  const auto digit = [&](std::size_t i) {
    return i < text.size() && std::isdigit(static_cast<unsigned char>(text[i]));
  };
  for (std::size_t i = 0; i < text.size();) {
    const bool in_name = i > 0 && (std::isalnum(static_cast<unsigned char>(text[i - 1])) || text[i - 1] == '_');
    const std::size_t first = i + (text[i] == '-' && digit(i + 1));
    if (in_name || !digit(first)) {
      kind += text[i++];
      continue;
    }
    for (i = first; digit(i) || (text[i] == '.' && digit(i + 1)); ++i) {
    }
    if (i < text.size() && text[i] == 'e') {
      const std::size_t exponent = i + 1 + (i + 1 < text.size() && (text[i + 1] == '-' || text[i + 1] == '+'));
      if (digit(exponent))
        for (i = exponent; digit(i); ++i) {
        }
    }
    kind += '#';
  }
  return kind;
}

/// Asks the master once what is advertised, on a thread of its own: with the master gone a call may take minutes.
struct NodeHealth::Inquiry {
  std::mutex mutex;
  std::condition_variable changed;
  bool over = false, answered = false;
  std::set<std::string> advertised;
  ros::WallTime begun = ros::WallTime::now();

  static std::shared_ptr<Inquiry> begin() {
    auto inquiry = std::make_shared<Inquiry>();
    std::thread([inquiry] {
      XmlRpc::XmlRpcValue request, response, topics;
      request[0] = ros::this_node::getName();
      request[1] = "";
      std::set<std::string> names;
      bool answered = ros::master::execute("getPublishedTopics", request, response, topics, false);
      try {
        for (int i = 0; answered && i < topics.size(); ++i) names.insert(std::string(topics[i][0]));
      } catch (const XmlRpc::XmlRpcException&) {  // no list of topics: that is no ROS master
        answered = false;
      }
      const std::lock_guard<std::mutex> lock(inquiry->mutex);
      inquiry->advertised = std::move(names);
      inquiry->answered = answered;
      inquiry->over = true;
      inquiry->changed.notify_all();
    }).detach();
    return inquiry;
  }
  bool await(double seconds) {
    std::unique_lock<std::mutex> lock(mutex);
    return changed.wait_for(lock, std::chrono::duration<double>(seconds), [&] { return over; });
  }
};

NodeHealth::NodeHealth(const std::string& hardware_id)
    : started_(ros::WallTime::now()),
      watched_(started_),
      running_(started_),
      updater_(std::make_unique<diagnostic_updater::Updater>()) {
  updater_->setHardwareID(hardware_id);
  updater_->add("state", this, &NodeHealth::report);
  // A wall timer: diagnostics and warnings must come when /clock stands still, too.
  timer_ = ros::NodeHandle().createWallTimer(ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) { watch(); });
  report_timer_ = ros::NodeHandle().createWallTimer(ros::WallDuration(updater_->getPeriod()),
                                                    [this](const ros::WallTimerEvent&) { updater_->force_update(); });
}

NodeHealth::~NodeHealth() {
  timer_.stop();
  report_timer_.stop();
  if (inquiry_) inquiry_->await(kMasterAnswers);  // it should not outlive roscpp
}

void NodeHealth::expectInput(const std::string& topic, bool continuous, const std::string& alternative,
                             const std::string& hint) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Input& input = inputs_[topic];
  input.last_arrival = ros::WallTime::now();
  input.continuous = continuous;
  input.alternative = alternative;
  input.hint = hint;
}

void NodeHealth::received(const std::string& topic, const ros::Time& stamp) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Input& input = inputs_[topic];
  ++input.messages;
  input.last_stamp = stamp;
  input.last_arrival = ros::WallTime::now();
  input.warned = false;
  input.behind = behindClock(stamp);
  input.apart = std::abs(input.behind) > kClocksApart ? input.apart + 1 : 0;
}

/// Empty: none.
std::string NodeHealth::Input::clockProblem(const std::string& topic) const {
  if (!continuous || apart < kApartInARow) return "";
  return topic + " is stamped " + std::to_string(std::lround(std::abs(behind))) + " s " +
         (behind > 0 ? "behind" : "ahead of") + " this machine's clock";
}

void NodeHealth::published() {
  const std::lock_guard<std::mutex> lock(mutex_);
  silence_.lasts = false;
}

void NodeHealth::withheld(const std::string& reason, const std::string& advice) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const ros::WallTime now = ros::WallTime::now();
  if (!silence_.lasts) silence_.since = now;
  silence_.lasts = true;
  silence_.last = now;
  silence_.reason = reason;
  silence_.advice = advice;
}

void NodeHealth::count(const std::string& event, std::size_t times) {
  if (times == 0) return;
  std::string name = event;
  bool first;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::string kind = kindOf(event);
    if (counters_.size() >= kMostKinds && !counters_.count(kind)) kind = name = "events of further kinds";
    Counter& counter = counters_[kind];
    first = counter.times == 0;
    if (first) counter.name = name;
    counter.times += times;
  }
  if (first) ROS_WARN_STREAM(name << " (said once; counted in /diagnostics)");
}

std::size_t NodeHealth::counted(const std::string& event) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto it = counters_.find(kindOf(event));
  return it == counters_.end() ? 0 : it->second.times;
}

void NodeHealth::value(const std::string& name, double value) {
  const std::lock_guard<std::mutex> lock(mutex_);
  values_[name] = value;
}

void NodeHealth::timing(const std::string& step, double seconds) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Timing& t = timings_[step];
  ++t.runs;
  t.sum += seconds;
  t.max = std::max(t.max, seconds);
}

void NodeHealth::state(Level level, const std::string& line) {
  const std::lock_guard<std::mutex> lock(mutex_);
  level_ = level;
  line_ = line;
}

void NodeHealth::watch() {
  const ros::WallTime now = ros::WallTime::now();
  const ros::Time clock = ros::Time::now();
  bool paused, fed = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    paused = ros::Time::isSimTime() && clock == clock_;
    for (const auto& [topic, input] : inputs_) fed = fed || (input.continuous && input.messages > 0);
  }
  ClockWatch::instance().watch(now, clock, fed);
  if (paused) running_ = now;
  watchInputs(now, paused);
  watchSilence(now, paused);
  watchClocks(now);
  const std::lock_guard<std::mutex> lock(mutex_);
  watched_ = now;
  clock_ = clock;
}

void NodeHealth::watchInputs(const ros::WallTime& now, bool paused) {
  const std::size_t before = silent_.size();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (auto& [topic, input] : inputs_) {
      if (paused && input.messages > 0) input.last_arrival += now - watched_;
      if (!input.continuous && input.messages > 0) continue;
      if (input.warned || (now - input.last_arrival).toSec() < kSilence) continue;
      input.warned = true;
      silent_[topic] = input;
    }
  }
  if (silent_.empty()) return;
  if (silent_.size() > before && (!inquiry_ || inquiry_->await(0))) inquiry_ = Inquiry::begin();
  const bool over = inquiry_->await(0);
  if (!over && (now - inquiry_->begun).toSec() < kMasterAnswers) return;
  for (const auto& [topic, input] : silent_) {
    const bool advertised = over && inquiry_->advertised.count(topic) > 0;
    const bool rare = advertised && !input.continuous;
    const double patience = rare ? kRare : kSilence;
    const bool opening = clock_.isZero() && (now - started_).toSec() < kOpening;
    if ((advertised || opening) && input.messages == 0 && (now - running_).toSec() < patience) {
      // The player has yet to begin, or the map.
      const std::lock_guard<std::mutex> lock(mutex_);
      inputs_[topic].warned = false;
      inputs_[topic].last_arrival = running_ + ros::WallDuration(patience - kSilence);
      continue;
    }
    std::ostringstream line;
    line << "nothing on " << topic << " for " << patience << " s: ";
    if (!over || !inquiry_->answered)
      line << "the ROS master does not answer";
    else if (advertised)
      line << "it is advertised, but no message comes"
           << (rare ? ". What its node waits for, that says on the console and in /diagnostics" : "");
    else
      line << "nobody publishes it (is a remapping or a namespace wrong?)";
    if (over && inquiry_->advertised.count(input.alternative) > 0)
      line << ", but " << input.alternative << " is advertised: " << input.hint;
    if (input.messages > 0)
      line << "; the last of " << input.messages << " messages has the stamp " << input.last_stamp;
    ROS_WARN_STREAM(line.str());
  }
  silent_.clear();
}

void NodeHealth::watchSilence(const ros::WallTime& now, bool paused) {
  std::string line;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    Silence& s = silence_;
    if (!s.lasts) return;
    if (paused) {
      s.since += now - watched_;
      s.last += now - watched_;
    }
    // Inputs that stay away have a warning of their own.
    if ((now - s.since).toSec() < kSilence || (now - s.last).toSec() > kSilence) return;
    const std::string kind = kindOf(s.reason);
    const auto said = s.said.find(kind);
    if (said != s.said.end() && (now - said->second).toSec() < kSayAgain) return;
    if (s.said.size() >= kMostKinds) s.said.clear();
    s.said[kind] = now;
    std::ostringstream text;
    text << "images come, but no pose for " << std::lround((now - s.since).toSec()) << " s: " << s.reason;
    if (!s.advice.empty()) text << ". What to do: " << s.advice;
    line = text.str();
  }
  ROS_WARN_STREAM(line);
}

void NodeHealth::watchClocks(const ros::WallTime& now) {
  std::vector<std::string> lines;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (auto& [topic, input] : inputs_) {
      const std::string problem = input.clockProblem(topic);
      if (problem.empty() || (now - input.last_arrival).toSec() > kSilence) continue;
      if (!input.told.isZero() && (now - input.told).toSec() < kSayAgain) continue;
      input.told = now;
      lines.push_back(problem);
    }
  }
  for (const std::string& line : lines)
    ROS_WARN_STREAM(line << ": synchronise the clocks (chrony), or see whether the link lags; if a bag is played: "
                            "/use_sim_time true, and rosbag play --clock");
}

void NodeHealth::report(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  status.summary(static_cast<unsigned char>(level_), line_);
  for (const auto& [topic, input] : inputs_)
    if (input.warned && input.messages > 0)
      status.summaryf(diagnostic_msgs::DiagnosticStatus::ERROR, "%s; nothing on %s for %.0f s",
                      std::string(status.message).c_str(), topic.c_str(),
                      (ros::WallTime::now() - input.last_arrival).toSec());
  for (const auto& [topic, input] : inputs_) {
    const std::string problem = input.clockProblem(topic);
    if (problem.empty()) continue;
    status.summaryf(std::max<unsigned char>(status.level, diagnostic_msgs::DiagnosticStatus::WARN), "%s; %s",
                    std::string(status.message).c_str(), problem.c_str());
  }
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
  for (const auto& [name, figure] : values_) status.addf(name, "%.3f", figure);
  for (const auto& [kind, counter] : counters_) status.addf(counter.name, "%zu", counter.times);
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

StreamJumpDetector::Verdict StreamJumpDetector::watch(std::size_t index, double t, const ros::WallTime& now) {
  Stream& stream = streams_.at(index);
  if (t == 0 || t > kEndOfStamps) return Verdict::kUnset;
  const bool back = t + tolerance_ < stream.newest;
  Verdict verdict = Verdict::kInOrder;
  if (stream.pass == pass_) {
    if (hold(&stream, t)) return Verdict::kHeld;
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

bool StreamGate::admit(std::size_t stream, double stamp) {
  using Verdict = StreamJumpDetector::Verdict;
  switch (jumps_.watch(stream, stamp)) {
    case Verdict::kInOrder:
      return true;
    case Verdict::kJump:
      reset_();
      return true;
    case Verdict::kOld:
      health_.count("messages of the time before a jump dropped");
      break;
    case Verdict::kUnset:
      health_.count("messages whose stamp was not set dropped");
      break;
    case Verdict::kHeld:
      health_.count("messages far from those before in time dropped (one a gap is: the next confirms it)");
      break;
  }
  return false;
}

}  // namespace air_ground_common::ros_utils
