// In which order clouds go out: new ones to all subscribers, those that are kept to each that comes later, and to it
// before any new one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

namespace dense_fusion {

/// A cloud older than the newest looks to its receivers as if time had jumped back: none may get one. `Cloud`: what is
/// sent. Stamps in nanoseconds, which rise in each map. Not thread-safe.
template <typename Cloud>
class CloudOrder {
 public:
  /// What a subscriber lacks that has come late: the clouds with these stamps, ends included, that are kept still.
  struct Share {
    std::int64_t first, last;
    std::uint64_t map;
  };

  /// The map has ended: nobody gets what was of it.
  void startMap() {
    ++map_;
    sent_.reset();
    waiting_.clear();
  }
  void add(std::int64_t stamp, Cloud cloud) { waiting_.emplace_back(stamp, std::move(cloud)); }

  // ---- A subscriber has come. One after the other: served() must follow.

  std::optional<Share> welcome() {
    serving_ = true;
    return sent_;
  }
  /// False: the map has ended, and the rest is not to be sent.
  bool stands(const Share& share) const { return share.map == map_; }
  void served() {
    serving_ = false;
    ++served_;
  }
  /// One that was served has left.
  void left() { --served_; }

  /// What is to be sent to all, in this order, now that there are `subscribers`: nothing while one of them has not been
  /// served. It counts as sent.
  std::vector<Cloud> due(std::size_t subscribers) {
    std::vector<Cloud> clouds;
    if (serving_ || subscribers > served_) return clouds;
    for (auto& [stamp, cloud] : waiting_) {
      sent_ = Share{sent_ ? sent_->first : stamp, stamp, map_};
      clouds.push_back(std::move(cloud));
    }
    waiting_.clear();
    return clouds;
  }

 private:
  std::uint64_t map_ = 0;
  std::optional<Share> sent_;
  std::vector<std::pair<std::int64_t, Cloud>> waiting_;
  bool serving_ = false;
  std::size_t served_ = 0;
};

}  // namespace dense_fusion
