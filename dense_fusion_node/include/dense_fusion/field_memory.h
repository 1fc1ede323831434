// Memory of large arrays that come and go with each fusion.
#pragma once

#include <cstddef>
#include <mutex>
#include <vector>

namespace dense_fusion {

/// Blocks in large pages: a volume of 13 million floats is 13,000 pages of 4 KiB, whose faults took longer than the
/// work on them. What is given back serves whoever comes next, since the kernel clears fresh pages, a quarter of the
/// time of a fusion; until then the kernel may have it where memory is short. All blocks together never hold more than
/// twice what was once asked for at the same time. Thread-safe.
class FieldMemory {
 public:
  static constexpr std::size_t kPage = std::size_t{1} << 21;  ///< to whose multiples sizes are rounded up

  FieldMemory() = default;
  FieldMemory(const FieldMemory&) = delete;
  FieldMemory& operator=(const FieldMemory&) = delete;
  ~FieldMemory();
  /// Of arbitrary content. Throws std::bad_alloc.
  void* take(std::size_t bytes);
  void giveBack(void* memory) noexcept;  ///< that take() returned
  std::size_t held() const;              ///< in use, and waiting to be [bytes]

 private:
  struct Block {
    void* memory;
    std::size_t bytes;
    bool used;
  };

  bool releaseOne();

  mutable std::mutex mutex_;
  std::vector<Block> blocks_;
  std::size_t held_ = 0, used_ = 0, most_used_ = 0;
};

/// That of the process.
FieldMemory& fieldMemory();

}  // namespace dense_fusion
