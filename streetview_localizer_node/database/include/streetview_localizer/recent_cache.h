// Costly things, made when they are asked for, of which memory holds a part.
#pragma once

#include <cstddef>
#include <list>
#include <mutex>
#include <unordered_map>
#include <utility>

namespace streetview_localizer {

/// As many things as fit into a number of bytes, those asked for last, at least one. Thread-safe.
template <typename Thing>
class RecentCache {
 public:
  RecentCache(std::size_t most_bytes, std::size_t (*bytes_of)(const Thing&))
      : most_bytes_(most_bytes), bytes_of_(bytes_of) {}

  /// The thing of this number, if need be made by `make()`, which others need not wait for: where two threads make one,
  /// both get the one that was ready first. What `make` throws passes.
  template <typename Make>
  Thing get(int number, const Make& make) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (const Thing* kept = find(number)) return *kept;
    }
    Thing made = make();
    const std::lock_guard<std::mutex> lock(mutex_);
    if (const Thing* kept = find(number)) return *kept;
    bytes_ += bytes_of_(made);
    things_.emplace_front(number, made);
    place_of_[number] = things_.begin();
    while (bytes_ > most_bytes_ && things_.size() > 1) {
      bytes_ -= bytes_of_(things_.back().second);
      place_of_.erase(things_.back().first);
      things_.pop_back();
    }
    return made;
  }

 private:
  using Things = std::list<std::pair<int, Thing>>;

  const Thing* find(int number) {
    const auto found = place_of_.find(number);
    if (found == place_of_.end()) return nullptr;
    things_.splice(things_.begin(), things_, found->second);
    return &found->second->second;
  }

  const std::size_t most_bytes_;
  std::size_t (*const bytes_of_)(const Thing&);
  std::mutex mutex_;
  Things things_;  // the one asked for last first
  std::unordered_map<int, typename Things::iterator> place_of_;
  std::size_t bytes_ = 0;
};

}  // namespace streetview_localizer
