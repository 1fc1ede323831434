// A queue of messages that neither their number nor their size lets grow without end.
#pragma once

#include <cstddef>
#include <deque>
#include <limits>
#include <utility>

namespace air_ground_common {

/// What a queue holds at the most; beyond, the oldest go.
struct QueueLimits {
  std::size_t count = 400;
  std::size_t bytes = std::numeric_limits<std::size_t>::max();  ///< of all entries; the newest stays, whatever its size
};

/// Entries that had to go, by the limit that was reached.
struct QueueOverflow {
  std::size_t by_count = 0, by_bytes = 0;
};

/// First in, first out. Not thread-safe.
template <typename T>
class BoundedQueue {
 public:
  explicit BoundedQueue(const QueueLimits& limits) : limits_(limits) {}

  void push(T entry, std::size_t bytes) {
    for (; !entries_.empty() && entries_.size() >= limits_.count; pop()) ++overflow_.by_count;
    for (; !entries_.empty() && bytes_ + bytes > limits_.bytes; pop()) ++overflow_.by_bytes;
    entries_.push_back(std::move(entry));
    sizes_.push_back(bytes);
    bytes_ += bytes;
  }
  /// The oldest; call when there is one.
  T pop() {
    T oldest = std::move(entries_.front());
    entries_.pop_front();
    bytes_ -= sizes_.front();
    sizes_.pop_front();
    return oldest;
  }
  void clear() {
    entries_.clear();
    sizes_.clear();
    bytes_ = 0;
  }

  const std::deque<T>& entries() const { return entries_; }  ///< the oldest first
  std::size_t bytes() const { return bytes_; }
  const QueueOverflow& overflow() const { return overflow_; }  ///< since the begin

 private:
  QueueLimits limits_;
  std::deque<T> entries_;
  std::deque<std::size_t> sizes_;
  std::size_t bytes_ = 0;
  QueueOverflow overflow_;
};

}  // namespace air_ground_common
