// What every node says about itself: diagnostics with rates, latency and counters, a warning when inputs stay away or
// nothing comes of them, and detection of time jumping back (a looped bag).
#pragma once

#include <ros/node_handle.h>
#include <ros/time.h>
#include <ros/wall_timer.h>

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "air_ground_common/ros/master_watch.h"

namespace diagnostic_updater {
class DiagnosticStatusWrapper;
class Updater;
}  // namespace diagnostic_updater

namespace air_ground_common::ros_utils {

/// ROS keeps no order between topics: after a pause of the process, messages of one topic are handled before older ones
/// of another. Wait this long after a message before concluding that another topic lacks its partner [s, wall clock].
constexpr double kTopicsInStep = 0.3;

/// Where the time ends that a stamp can hold [s], but for a day: beyond, roscpp and tf2 throw when they add to it or
/// make one from seconds. Such stamps, of all ones (-1) above all, were not set.
constexpr double kEndOfStamps = 4294967295.0 - 86400;

/// Kind of an event or a reason: its text with every number that stands by itself replaced by '#'. "9 of 80 tracks" and
/// "14 of 105 tracks" are of one kind, "camera1" and "camera2" are not.
std::string kindOf(const std::string& text);

/// Thread-safe. One per node; all calls may come from any thread. None of them waits for the master. While it lives the
/// node registers with a master that was started again: see MasterWatch.
class NodeHealth {
 public:
  /// `hardware_id` names the node in /diagnostics, e.g. "mav_vo". It reports there every `~diagnostic_period` [s, wall
  /// clock], the parameter of diagnostic_updater, as it is now; once a second without.
  explicit NodeHealth(const std::string& hardware_id);
  ~NodeHealth();

  /// Declares an input that the node waits for. After 3 s (wall time) without it a warning names the resolved topic,
  /// whether anybody publishes it, and the last stamp seen. `continuous` false: a topic that may rightly pause (a
  /// latched map); the warning comes only while nothing at all has arrived, and where somebody advertises it, after
  /// 30 s: it takes a map first, or a flight. A replay that is paused (/clock stands still) is no silence.
  /// `hint`, when not empty, ends the warning if somebody advertises `alternative`: the same data in another form.
  void expectInput(const std::string& resolved_topic, bool continuous = true, const std::string& alternative = "",
                   const std::string& hint = "");
  /// Call in the callback of an expected input. Where the stamps of a continuous one stay more than 5 s away from the
  /// clock of a live node, a warning says so once a minute: tf would be of no use, and nothing else would tell.
  void received(const std::string& resolved_topic, const ros::Time& stamp);

  /// What became of an input that outputs are made from, an image say. While they come and nothing is published for
  /// 3 s (wall time; a paused replay does not count) a warning says why and what to do: once for each kind of reason,
  /// again after a minute at the earliest.
  void published();
  void withheld(const std::string& reason, const std::string& advice = "");

  /// Adds to a named counter shown in /diagnostics, e.g. count("images without calibration"). Warns once per name.
  /// Events of one kind share a counter under the name of the first; beyond 100 kinds all go into one.
  void count(const std::string& event, std::size_t times = 1);
  /// Times the event was counted.
  std::size_t counted(const std::string& event) const;

  /// Records the time [s] that a step took: mean and maximum appear in /diagnostics.
  void timing(const std::string& step, double seconds);

  /// A figure as it is now, in /diagnostics, e.g. value("lag [s]", 0.2).
  void value(const std::string& name, double value);

  /// As in diagnostic_msgs::DiagnosticStatus.
  enum Level { kOk, kWarn, kError };
  /// Sets the state line.
  void state(Level level, const std::string& line);

 private:
  struct Input {
    std::size_t messages = 0;
    ros::Time last_stamp;
    ros::WallTime last_arrival;
    bool warned = false;
    bool continuous = true;
    std::string alternative, hint;
    double behind = 0;      ///< the clock of this machine, the last stamp [s]
    std::size_t apart = 0;  ///< messages in a row whose stamps were too far from it
    ros::WallTime told;     ///< of that
    std::string clockProblem(const std::string& topic) const;
  };
  struct Counter {
    std::string name;
    std::size_t times = 0;
  };
  /// Inputs of which nothing is published.
  struct Silence {
    bool lasts = false;
    ros::WallTime since, last;  ///< of the inputs
    std::string reason, advice;
    std::map<std::string, ros::WallTime> said;  ///< by kind of reason
  };
  struct Inquiry;
  struct Timing {
    std::size_t runs = 0;
    double sum = 0, max = 0;
  };

  void report(diagnostic_updater::DiagnosticStatusWrapper& status);
  void watch();
  void watchInputs(const ros::WallTime& now, bool paused);
  void watchSilence(const ros::WallTime& now, bool paused);
  void watchClocks(const ros::WallTime& now);

  mutable std::mutex mutex_;
  std::map<std::string, Input> inputs_;
  std::map<std::string, Counter> counters_;  ///< by kind
  std::map<std::string, double> values_;
  Silence silence_;
  std::map<std::string, Timing> timings_;
  Level level_ = kWarn;
  std::string line_ = "starting";
  // Of the timer's thread.
  std::map<std::string, Input> silent_;  ///< to be said when the inquiry is over
  std::shared_ptr<Inquiry> inquiry_;
  ros::WallTime started_, watched_, running_;  ///< running_: since when the clock does without a pause
  ros::Time clock_;                            ///< when watched_
  const std::unique_ptr<diagnostic_updater::Updater> updater_;
  ros::WallTimer timer_, report_timer_;
  MasterWatch master_watch_;
};

/// Detects time running backwards, as when a bag loops or /clock is reset. Thread-safe.
class TimeJumpDetector {
 public:
  /// `tolerance` [s]: messages out of order by less are no jump.
  explicit TimeJumpDetector(double tolerance = 1.0) : tolerance_(tolerance) {}
  /// True once per jump: `stamp` lies more than the tolerance before the newest stamp seen. Then starts afresh from it.
  bool jumped(const ros::Time& stamp);

 private:
  std::mutex mutex_;
  double tolerance_;
  double newest_ = -1;  ///< [s]; differences of ros::Time throw for stamps of more than 2^31 s
};

/// The same for a node with several inputs, of which one may lag behind the others. The first stream to jump starts a
/// new pass; what still comes of the old pass on the others is told apart. A single wrong stamp in a fast stream (IMU,
/// images, odometry) is no jump: there, a leap forth or back counts when the next message confirms it. Not thread-safe.
class StreamJumpDetector {
 public:
  enum class Verdict {
    kInOrder,  ///< use it
    kJump,     ///< time ran back: start afresh, then use it
    kOld,      ///< drop it: from before the jump
    kUnset,    ///< drop it: its stamp was not set
    kHeld      ///< drop it: far off, and not confirmed by a second one; a gap costs one message
  };

  /// `patience`: a stream that has not followed a jump after this long is taken as it comes [s, wall clock].
  explicit StreamJumpDetector(std::size_t streams, double tolerance = 1.0, double patience = 3.0)
      : streams_(streams), tolerance_(tolerance), patience_(patience) {}

  /// `stamp` [s]. All zeros and all ones (-1) stand for one that was not set. Throws std::out_of_range for an unknown
  /// stream.
  Verdict watch(std::size_t stream, double stamp, const ros::WallTime& now = ros::WallTime::now());
  Verdict watch(std::size_t stream, const ros::Time& stamp, const ros::WallTime& now = ros::WallTime::now()) {
    return watch(stream, stamp.toSec(), now);
  }

 private:
  struct Stream {
    double newest = -1;   ///< [s]; -1: nothing yet
    double interval = 0;  ///< running mean [s]
    double held = -1;     ///< stamp of a leap that the next message may confirm [s]
    std::size_t messages = 0;
    unsigned pass = 0;
  };
  /// True when `t` must wait for confirmation by the next message.
  bool hold(Stream* stream, double t) const;

  std::vector<Stream> streams_;
  double tolerance_, patience_;
  unsigned pass_ = 0;
  double newest_ = -1;                    ///< of the present pass [s]
  double old_newest_ = -1, ceiling_ = 0;  ///< of the pass before; between the passes [s]
  ros::WallTime jumped_;
};

/// What a node does with the verdict: starts afresh at a jump, and counts what it drops. Not thread-safe.
class StreamGate {
 public:
  /// `reset` is called at a jump, before the message that shows it is used.
  StreamGate(std::size_t streams, NodeHealth& health, std::function<void()> reset)
      : jumps_(streams), health_(health), reset_(std::move(reset)) {}

  /// False: drop the message. `stamp` [s].
  bool admit(std::size_t stream, double stamp);
  bool admit(std::size_t stream, const ros::Time& stamp) { return admit(stream, stamp.toSec()); }

 private:
  StreamJumpDetector jumps_;
  NodeHealth& health_;
  std::function<void()> reset_;
};

}  // namespace air_ground_common::ros_utils
