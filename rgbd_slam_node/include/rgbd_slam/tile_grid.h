// Cells all over a map, of which only those are kept that somebody asked for, a tile of them at once.
#pragma once

#include <cstdint>
#include <memory>
#include <unordered_map>

namespace rgbd_slam {

/// Not thread-safe.
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
    const auto it = tiles_.find(key);
    return it == tiles_.end() ? nullptr : it->second.get();
  }
  void clear() {
    tiles_.clear();
    last_ = nullptr;
  }

 private:
  std::unordered_map<std::int64_t, std::unique_ptr<Tile>> tiles_;
  Tile* last_ = nullptr;  // most are asked for again at once
  std::int64_t last_key_ = 0;
};

}  // namespace rgbd_slam
