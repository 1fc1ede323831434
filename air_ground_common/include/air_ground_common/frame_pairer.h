// Pairs colour and depth images by their stamps.
#pragma once

#include <cmath>
#include <deque>
#include <optional>
#include <utility>

namespace air_ground_common {

/// T: anything copyable, e.g. a message pointer. Each stream in order of time. Not thread-safe.
template <typename T>
class FramePairer {
 public:
  /// `tolerance`: largest difference of the stamps of a pair [s]. A colour image waits for depth until one that is
  /// `patience` [s] newer has been here for `settle` [s]: whole seconds of one topic may come before the other's.
  FramePairer(double tolerance, double patience, double settle, std::size_t limit)
      : tolerance_(tolerance), patience_(patience), settle_(settle), limit_(limit) {}

  /// `now`, here and below: time of a clock that runs on while the stamps may not [s].
  void addColour(double stamp, T image, double now) { push(&colour_, stamp, std::move(image), now); }
  void addDepth(double stamp, T image, double now) { push(&depth_, stamp, std::move(image), now); }

  struct Pair {
    double stamp;  ///< of the colour image [s]
    T colour, depth;
  };

  /// The oldest pair, if it is known: drops what can no longer find a partner. Does not remove the pair.
  const Pair* front(double now) {
    while (!pair_ && !colour_.empty()) {
      const double stamp = colour_.front().stamp;
      while (!depth_.empty() && depth_.front().stamp < stamp - tolerance_) {
        depth_.pop_front();
        ++unmatched_depth_;
      }
      while (depth_.size() > 1 && std::abs(depth_[1].stamp - stamp) < std::abs(depth_[0].stamp - stamp)) {
        depth_.pop_front();
        ++unmatched_depth_;
      }
      if (!depth_.empty() && depth_.front().stamp <= stamp + tolerance_) {
        pair_ = Pair{stamp, std::move(colour_.front().image), std::move(depth_.front().image)};
        colour_.pop_front();
        depth_.pop_front();
        break;
      }
      const bool missed = !depth_.empty();  // depth is already newer
      if (!missed && !overtaken(stamp, patience_, now)) break;
      if (missed) closest_miss_ = depth_.front().stamp - stamp;
      colour_.pop_front();
      ++unmatched_colour_;
    }
    return pair_ ? &*pair_ : nullptr;
  }

  Pair pop() {
    Pair pair = std::move(*pair_);
    pair_.reset();
    return pair;
  }

  void clear() {
    colour_.clear();
    depth_.clear();
    pair_.reset();
    unmatched_colour_ = unmatched_depth_ = overflow_ = 0;
  }

  /// True when a colour image newer than `stamp` by more than this [s] has been waiting for `settle`.
  bool overtaken(double stamp, double by, double now) const {
    for (const Waiting& colour : colour_)
      if (colour.stamp - stamp > by) return now - colour.arrival >= settle_;
    return false;
  }
  std::size_t waiting() const { return colour_.size() + (pair_ ? 1 : 0); }
  /// Counted since the last call of clear().
  std::size_t unmatchedColour() const { return unmatched_colour_; }
  std::size_t unmatchedDepth() const { return unmatched_depth_; }
  std::size_t overflow() const { return overflow_; }
  /// Depth stamp minus colour stamp of the last colour image that found no partner [s].
  double closestMiss() const { return closest_miss_; }

 private:
  struct Waiting {
    double stamp, arrival;
    T image;
  };
  using Queue = std::deque<Waiting>;

  void push(Queue* queue, double stamp, T image, double now) {
    if (!queue->empty() && stamp <= queue->back().stamp) {
      ++overflow_;
      return;
    }
    if (queue->size() >= limit_) {
      queue->pop_front();
      ++overflow_;
    }
    queue->push_back({stamp, now, std::move(image)});
  }

  double tolerance_, patience_, settle_;
  std::size_t limit_;
  Queue colour_, depth_;
  std::optional<Pair> pair_;
  std::size_t unmatched_colour_ = 0, unmatched_depth_ = 0, overflow_ = 0;
  double closest_miss_ = 0;
};

}  // namespace air_ground_common
