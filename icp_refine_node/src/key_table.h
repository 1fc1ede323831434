// Hash table from cells of a grid to small numbers: the arrays beside it hold what belongs to a cell.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

namespace icp_refine {

/// Numbers keys 0, 1, ... in the order in which they first come. Open addressing.
class KeyTable {
 public:
  /// Number of the key, which is new when it equals the size() before.
  int insert(std::uint64_t key) {
    if (2 * static_cast<std::size_t>(size_) >= slots_.size()) grow();
    auto& [stored, number] = slots_[place(key)];
    if (number < 0) stored = key, number = size_++;
    return number;
  }
  /// -1: never inserted.
  int find(std::uint64_t key) const { return slots_[place(key)].second; }
  int size() const { return size_; }

 private:
  std::size_t place(std::uint64_t key) const {
    const std::size_t mask = slots_.size() - 1;
    std::size_t at = (key * 0x9E3779B97F4A7C15ull) >> 32 & mask;
    while (slots_[at].second >= 0 && slots_[at].first != key) at = (at + 1) & mask;
    return at;
  }
  void grow() {
    std::vector<std::pair<std::uint64_t, int>> old(4 * slots_.size(), {0, -1});
    old.swap(slots_);
    for (const auto& slot : old) {
      if (slot.second >= 0) slots_[place(slot.first)] = slot;
    }
  }

  std::vector<std::pair<std::uint64_t, int>> slots_ = std::vector<std::pair<std::uint64_t, int>>(1024, {0, -1});
  int size_ = 0;
};

}  // namespace icp_refine
