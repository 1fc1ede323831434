// Values by time: what a node keeps of one topic to look up for another.
#pragma once

#include <cmath>
#include <cstddef>
#include <deque>
#include <limits>
#include <utility>

namespace air_ground_common {

/// In order of time, bounded in time and in number. Not thread-safe.
template <typename Value>
class StampedBuffer {
 public:
  using Entry = std::pair<double, Value>;  ///< stamp [s], value

  /// Keeps what is at most `span` older than the newest [s], `most` values at the most. `same`: stamps this close are
  /// one [s].
  explicit StampedBuffer(double span, std::size_t most = 20000, double same = 1e-6)
      : span_(span), most_(most), same_(same) {}

  /// A value of a stamp that is there already, or of an earlier time, is not taken: false. One of before the span
  /// begins afresh: time has jumped, or the newest stamp was wrong.
  bool add(double stamp, Value value) {
    if (stamp < newest() - span_) entries_.clear();
    if (!std::isfinite(stamp) || (!entries_.empty() && stamp <= entries_.back().first + same_)) return false;
    entries_.emplace_back(stamp, std::move(value));
    while (entries_.size() > most_ || entries_.front().first < stamp - span_) entries_.pop_front();
    return true;
  }

  /// The value nearest in time, at most `tolerance` away [s]; null when there is none. Valid until the next add or
  /// clear.
  const Value* nearest(double stamp, double tolerance) const {
    const Entry* best = nullptr;
    for (auto it = entries_.rbegin(); it != entries_.rend(); ++it) {
      if (!best || std::abs(it->first - stamp) < std::abs(best->first - stamp)) best = &*it;
      if (it->first < stamp) break;
    }
    return best && std::abs(best->first - stamp) <= tolerance ? &best->second : nullptr;
  }

  /// Stamp of the newest value [s]; minus infinity without one.
  double newest() const { return entries_.empty() ? -std::numeric_limits<double>::infinity() : entries_.back().first; }
  std::size_t size() const { return entries_.size(); }
  bool empty() const { return entries_.empty(); }
  void clear() { entries_.clear(); }

 private:
  std::deque<Entry> entries_;
  double span_;
  std::size_t most_;
  double same_;
};

}  // namespace air_ground_common
