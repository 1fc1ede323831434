// Pairs colour and depth images by their stamps.
#pragma once

#include <cmath>
#include <deque>
#include <optional>
#include <utility>

namespace rgbd_slam {

/// T: anything copyable, e.g. a message pointer. Each stream in order of time. Not thread-safe.
template <typename T>
class FramePairer {
 public:
  /// `tolerance`: largest difference of the stamps of a pair [s]. A colour image waits for depth until colour images are
  /// `patience` newer [s].
  FramePairer(double tolerance, double patience, std::size_t limit) : tolerance_(tolerance), patience_(patience), limit_(limit) {}

  void addColour(double stamp, T image) { push(&colour_, stamp, std::move(image)); }
  void addDepth(double stamp, T image) { push(&depth_, stamp, std::move(image)); }

  struct Pair {
    double stamp;  ///< of the colour image [s]
    T colour, depth;
  };

  /// The oldest pair, if it is known: drops what can no longer find a partner. Does not remove the pair.
  const Pair* front() {
    while (!pair_ && !colour_.empty()) {
      const double stamp = colour_.front().first;
      while (!depth_.empty() && depth_.front().first < stamp - tolerance_) {
        depth_.pop_front();
        ++unmatched_depth_;
      }
      while (depth_.size() > 1 && std::abs(depth_[1].first - stamp) < std::abs(depth_[0].first - stamp)) {
        depth_.pop_front();
        ++unmatched_depth_;
      }
      if (!depth_.empty() && depth_.front().first <= stamp + tolerance_) {
        pair_ = Pair{stamp, std::move(colour_.front().second), std::move(depth_.front().second)};
        colour_.pop_front();
        depth_.pop_front();
        break;
      }
      const bool missed = !depth_.empty();  // depth is already newer
      if (!missed && colour_.back().first - stamp <= patience_) break;
      if (missed) closest_miss_ = depth_.front().first - stamp;
      colour_.pop_front();
      ++unmatched_colour_;
    }
    return pair_ ? &*pair_ : nullptr;
  }

  Pair take() {
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

  /// Newest colour stamp waiting minus `stamp`; 0 when none waits [s].
  double newerBy(double stamp) const { return colour_.empty() ? 0.0 : colour_.back().first - stamp; }
  std::size_t waiting() const { return colour_.size() + (pair_ ? 1 : 0); }
  /// Counted since the last call of clear().
  std::size_t unmatchedColour() const { return unmatched_colour_; }
  std::size_t unmatchedDepth() const { return unmatched_depth_; }
  std::size_t overflow() const { return overflow_; }
  /// Depth stamp minus colour stamp of the last colour image that found no partner [s].
  double closestMiss() const { return closest_miss_; }

 private:
  using Queue = std::deque<std::pair<double, T>>;

  void push(Queue* queue, double stamp, T image) {
    if (!queue->empty() && stamp <= queue->back().first) {
      ++overflow_;
      return;
    }
    if (queue->size() >= limit_) {
      queue->pop_front();
      ++overflow_;
    }
    queue->emplace_back(stamp, std::move(image));
  }

  double tolerance_, patience_;
  std::size_t limit_;
  Queue colour_, depth_;
  std::optional<Pair> pair_;
  std::size_t unmatched_colour_ = 0, unmatched_depth_ = 0, overflow_ = 0;
  double closest_miss_ = 0;
};

}  // namespace rgbd_slam
