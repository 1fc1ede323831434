// Pairs colour and depth images by their stamps.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <deque>
#include <optional>
#include <utility>

#include "air_ground_common/bounded_queue.h"

namespace air_ground_common {

/// Pairs are mutual nearest neighbours: before two images are paired, the next one of the older image's stream is
/// waited for where it could be nearer. Which images pair follows from their stamps, not from when they come, unless a
/// stream stops. T: anything copyable, e.g. a message pointer. Each stream in order of time. Not thread-safe.
template <typename T>
class FramePairer {
 public:
  /// `tolerance`: largest difference of the stamps of a pair [s]. A colour image waits for depth until one that is
  /// `patience` [s] newer has been here for `settle` [s]: whole seconds of one topic may come before the other's. Both
  /// wait for a rival, which may never come, for `patience` of `now`. `limits`: of each stream.
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
      while (!depth.empty() && depth.front().stamp < stamp && gap() > tolerance_) dropDepth();
      if (candidates()) {
        const Rival rival = findRival(now);
        if (rival == Rival::kAwaited) break;
        if (rival == Rival::kNone)
          takePair();
        else
          rival == Rival::kColour ? dropColour() : dropDepth();
      } else {
        noteMiss(stamp);
        const bool missed = !depth.empty();  // depth is already newer
        if (!missed && !overtaken(stamp, patience_, now)) break;
        dropColour();
      }
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
  /// Colour images that wait for a depth image: one that waits for a rival alone has its own.
  std::size_t waiting() const { return colour_.entries().size() + (pair_ ? 1 : 0) - (candidates() ? 1 : 0); }
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
  /// What fits one of the oldest two better than the other one does, which is in vain then.
  enum class Rival { kNone, kAwaited, kColour, kDepth };

  // Rivals count when they are nearer by more than this [s]: near half a period, jitter would change the partners,
  // which costs an image each time.
  static constexpr double kAlike = 0.004;

  void push(Queue* queue, Waiting image) {
    if (!queue->entries().empty() && image.stamp <= queue->entries().back().stamp) {
      ++out_of_order_;
      return;
    }
    const std::size_t bytes = image.bytes;
    queue->push(std::move(image), bytes);
  }
  /// The oldest colour image and the oldest depth image may be a pair.
  bool candidates() const { return !colour_.entries().empty() && !depth_.entries().empty() && gap() <= tolerance_; }
  double gap() const { return std::abs(depth_.entries().front().stamp - colour_.entries().front().stamp); }

  /// Only the stream of the older candidate can bring one: the other's next image is farther away.
  Rival findRival(double now) const {
    const Waiting &colour = colour_.entries().front(), &depth = depth_.entries().front();
    const bool of_colour = colour.stamp <= depth.stamp;
    const std::deque<Waiting>& rivals = of_colour ? colour_.entries() : depth_.entries();
    if (gap() <= kAlike) return Rival::kNone;
    if (rivals.size() < 2)
      return now - std::max(colour.arrival, depth.arrival) < patience_ ? Rival::kAwaited : Rival::kNone;
    const double nearest = std::abs(rivals[1].stamp - (of_colour ? depth : colour).stamp);
    if (nearest >= gap() - kAlike) return Rival::kNone;
    return of_colour ? Rival::kColour : Rival::kDepth;
  }
  void takePair() {
    Waiting a = colour_.pop(), b = popDepth();
    pair_ = Pair{a.stamp, std::move(a.image), std::move(b.image), a.bytes + b.bytes};
  }
  void noteMiss(double stamp) {
    const std::deque<Waiting>& depth = depth_.entries();
    if (older_depth_) closest_miss_ = *older_depth_ - stamp;
    if (!depth.empty() && (!older_depth_ || depth.front().stamp - stamp < stamp - *older_depth_))
      closest_miss_ = depth.front().stamp - stamp;
  }
  void dropColour() {
    colour_.pop();
    ++unmatched_colour_;
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
