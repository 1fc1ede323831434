// Pairs colour and depth images by their stamps.
#pragma once

#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

#include "air_ground_common/bounded_queue.h"

namespace air_ground_common {

/// T: anything copyable, e.g. a message pointer. Each stream in order of time. Not thread-safe.
template <typename T>
class FramePairer {
 public:
  /// `tolerance`: largest difference of the stamps of a pair [s]. A colour image waits for depth until one that is
  /// `patience` [s] newer has been here for `settle` [s]: whole seconds of one topic may come before the other's.
  /// `limits`: of each stream.
  FramePairer(double tolerance, double patience, double settle, const QueueLimits& limits)
      : tolerance_(tolerance), patience_(patience), settle_(settle), colour_(limits), depth_(limits) {}

  /// `now`, here and below: time of a clock that runs on while the stamps may not [s]. `bytes`: that the image takes.
  void addColour(double stamp, T image, double now, std::size_t bytes = 0) {
    push(&colour_, {stamp, now, std::move(image), bytes});
  }
  void addDepth(double stamp, T image, double now, std::size_t bytes = 0) {
    push(&depth_, {stamp, now, std::move(image), bytes});
  }

  struct Pair {
    double stamp;  ///< of the colour image [s]
    T colour, depth;
    std::size_t bytes;  ///< that both take
  };

  /// The oldest pair, if it is known: drops what can no longer find a partner. Does not remove the pair.
  const Pair* front(double now) {
    while (!pair_ && !colour_.entries().empty()) {
      const double stamp = colour_.entries().front().stamp;
      const std::deque<Waiting>& depth = depth_.entries();
      while (!depth.empty() && depth.front().stamp < stamp - tolerance_) dropDepth();
      while (depth.size() > 1 && std::abs(depth[1].stamp - stamp) < std::abs(depth[0].stamp - stamp)) dropDepth();
      if (!depth.empty() && depth.front().stamp <= stamp + tolerance_) {
        Waiting a = colour_.pop(), b = popDepth();
        pair_ = Pair{stamp, std::move(a.image), std::move(b.image), a.bytes + b.bytes};
        break;
      }
      const bool missed = !depth.empty();  // depth is already newer
      if (older_depth_) closest_miss_ = *older_depth_ - stamp;
      if (missed && (!older_depth_ || depth.front().stamp - stamp < stamp - *older_depth_))
        closest_miss_ = depth.front().stamp - stamp;
      if (!missed && !overtaken(stamp, patience_, now)) break;
      colour_.pop();
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
    older_depth_.reset();
    closest_miss_.reset();
    unmatched_colour_ = unmatched_depth_ = 0;
  }

  /// True when a colour image newer than `stamp` by more than this [s] has been waiting for `settle`.
  bool overtaken(double stamp, double by, double now) const {
    for (const Waiting& colour : colour_.entries())
      if (colour.stamp - stamp > by) return now - colour.arrival >= settle_;
    return false;
  }
  std::size_t waiting() const { return colour_.entries().size() + (pair_ ? 1 : 0); }
  /// Counted since the last call of clear().
  std::size_t unmatchedColour() const { return unmatched_colour_; }
  std::size_t unmatchedDepth() const { return unmatched_depth_; }
  /// Of both streams, since the begin.
  QueueOverflow overflow() const {
    const QueueOverflow &a = colour_.overflow(), &b = depth_.overflow();
    return {a.by_count + b.by_count, a.by_bytes + b.by_bytes};
  }
  std::size_t outOfOrder() const { return out_of_order_; }  ///< since the begin
  /// Depth stamp minus colour stamp of the last colour image without a partner, by the nearest depth image [s]; none
  /// while no depth image has come.
  std::optional<double> closestMiss() const { return closest_miss_; }

 private:
  struct Waiting {
    double stamp, arrival;
    T image;
    std::size_t bytes;
  };
  using Queue = BoundedQueue<Waiting>;

  void push(Queue* queue, Waiting image) {
    if (!queue->entries().empty() && image.stamp <= queue->entries().back().stamp) {
      ++out_of_order_;
      return;
    }
    const std::size_t bytes = image.bytes;
    queue->push(std::move(image), bytes);
  }
  Waiting popDepth() {
    older_depth_ = depth_.entries().front().stamp;
    return depth_.pop();
  }
  void dropDepth() {
    popDepth();
    ++unmatched_depth_;
  }

  double tolerance_, patience_, settle_;
  Queue colour_, depth_;
  std::optional<Pair> pair_;
  std::size_t unmatched_colour_ = 0, unmatched_depth_ = 0, out_of_order_ = 0;
  std::optional<double> older_depth_, closest_miss_;  ///< stamp of the last depth image taken out; the miss [s]
};

}  // namespace air_ground_common
