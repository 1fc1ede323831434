// Order among the odometry's messages: strays and looped bags told apart, increments matched with the poses of their
// stamps.
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "ekf_tracker/tilt_source.h"

namespace ekf_tracker {

/// Two topics carry one instant: an increment waits for the pose of its stamp, which tells tilt and tf, until a later
/// pose shows that it was left out or the wait is over. While the odometry is not metric it has no such pose to give:
/// it is waited for only if it gave one at the increment's begin. Times `now` are of a clock that never leaps [s]: a
/// bag may be replayed at any rate. Not thread-safe.
template <typename Message>
class IncrementSynchronizer {
 public:
  struct Arrival {
    double previous_stamp = 0, stamp = 0;  ///< [s]
    bool metric = false;
    Message message{};
  };
  enum class Admission {
    kTaken,
    kSetAside,  ///< more than a second older than the newest: a stray, unless others confirm it
    kJump  ///< time ran back: this one and those set aside before it are taken; clear whatever is of the time before
  };
  struct Ready {
    Message message;
    std::optional<air_ground_common::Pose> T_map_base;
  };

  /// `wait`: for the pose [s]; 0: poses are not asked for. `poses` must outlive this.
  IncrementSynchronizer(double wait, const TiltSource& poses) : wait_(wait), poses_(poses) {}

  /// At a jump: call before adding poses of the new time. What waited of the time before is dropped.
  Admission admit(const Arrival& arrival, double now) {
    if (!newest_ || arrival.stamp >= *newest_ - kOld) {
      from_the_past_.clear();
      enqueue(arrival, now);
      return Admission::kTaken;
    }
    // A single one is a stray, a run of them in order is a looped bag.
    if (!from_the_past_.empty() && arrival.stamp <= from_the_past_.back().stamp) from_the_past_.clear();
    from_the_past_.push_back(arrival);
    if (from_the_past_.size() < kRun) return Admission::kSetAside;
    const std::vector<Arrival> run = std::move(from_the_past_);
    clear();
    for (const Arrival& a : run) enqueue(a, now);
    return Admission::kJump;
  }

  /// The next increment that need not wait any longer.
  std::optional<Ready> next(double now) {
    if (pending_.empty()) return std::nullopt;
    const Arrival& a = pending_.front().arrival;
    std::optional<air_ground_common::Pose> T_map_base;
    if (wait_ > 0) {
      T_map_base = poses_.poseAt(a.stamp);
      const bool passed = poses_.newestPose() > a.stamp;
      const bool expected = a.metric || poses_.poseAt(a.previous_stamp);
      if (!T_map_base && !passed && expected && now - pending_.front().received <= wait_) return std::nullopt;
    }
    Ready ready{a.message, T_map_base};
    pending_.pop_front();
    return ready;
  }

  void clear() {
    pending_.clear();
    from_the_past_.clear();
    newest_.reset();
  }

 private:
  static constexpr double kOld = 1.0;     // [s]
  static constexpr std::size_t kRun = 3;  // increments in a row from the past

  struct Pending {
    Arrival arrival;
    double received = 0;  ///< [s]
  };

  void enqueue(const Arrival& arrival, double now) {
    newest_ = newest_ ? std::max(*newest_, arrival.stamp) : arrival.stamp;
    pending_.push_back({arrival, now});
  }

  double wait_;
  const TiltSource& poses_;
  std::deque<Pending> pending_;
  std::vector<Arrival> from_the_past_;
  std::optional<double> newest_;  ///< [s]
};

}  // namespace ekf_tracker
