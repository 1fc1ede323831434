// Cells all over a map, of which only those are kept that somebody asked for, a tile of them at once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <unordered_map>

namespace rgbd_slam {

/// Not thread-safe, its const functions neither.
template <typename Tile>
class TileGrid {
 public:
  /// Of the tile at these numbers, each within +-2^20.
  static std::int64_t keyOf(int x, int y, int z) {
    constexpr std::int64_t kBits = 0x1fffff;
    return (z & kBits) << 42 | (y & kBits) << 21 | (x & kBits);
  }

  /// Makes it where there is none.
  Tile& at(std::int64_t key) {
    if (!last_ || key != last_key_) {
      auto& tile = tiles_[key];
      if (!tile) tile = std::make_unique<Tile>();
      last_ = tile.get();
      last_key_ = key;
    }
    return *last_;
  }
  const Tile* find(std::int64_t key) const {
    if (key != last_key_) {
      const auto it = tiles_.find(key);
      last_ = it == tiles_.end() ? nullptr : it->second.get();
      last_key_ = key;
    }
    return last_;
  }
  std::size_t size() const { return tiles_.size(); }
  void clear() {
    tiles_.clear();
    last_ = nullptr;
    last_key_ = kNoKey;
  }

 private:
  static constexpr std::int64_t kNoKey = -1;  // none that keyOf gives is negative

  std::unordered_map<std::int64_t, std::unique_ptr<Tile>> tiles_;
  // Most are asked for again at once.
  mutable Tile* last_ = nullptr;  // null: there is none
  mutable std::int64_t last_key_ = kNoKey;
};

}  // namespace rgbd_slam
