#include "dense_fusion/field_memory.h"

#include <sys/mman.h>

#include <algorithm>
#include <new>

namespace dense_fusion {
namespace {

constexpr std::align_val_t kAlignment{FieldMemory::kPage};

}  // namespace

FieldMemory::~FieldMemory() {
  for (const Block& block : blocks_) ::operator delete(block.memory, kAlignment);
}

void* FieldMemory::take(std::size_t bytes) {
  bytes = (bytes + kPage - 1) / kPage * kPage;
  const std::lock_guard<std::mutex> lock(mutex_);
  Block* best = nullptr;
  for (Block& block : blocks_) {
    const bool fits = !block.used && block.bytes >= bytes && block.bytes <= 2 * bytes;
    if (fits && (!best || block.bytes < best->bytes)) best = &block;
  }
  if (!best) {
    most_used_ = std::max(most_used_, used_ + bytes);
    while (held_ + bytes > most_used_ && releaseOne()) {
    }
    blocks_.reserve(blocks_.size() + 1);
    void* memory;
    while (!(memory = ::operator new(bytes, kAlignment, std::nothrow)))
      if (!releaseOne()) throw std::bad_alloc();
    madvise(memory, bytes, MADV_HUGEPAGE);  // where the kernel has none, small ones do
    best = &blocks_.emplace_back(Block{memory, bytes, false});
    held_ += bytes;
  }
  best->used = true;
  used_ += best->bytes;
  most_used_ = std::max(most_used_, used_);
  return best->memory;
}

void FieldMemory::giveBack(void* memory) noexcept {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto block =
      std::find_if(blocks_.begin(), blocks_.end(), [memory](const Block& b) { return b.memory == memory; });
  block->used = false;
  used_ -= block->bytes;
  madvise(memory, block->bytes, MADV_FREE);
}

// The smallest: it serves the fewest.
bool FieldMemory::releaseOne() {
  auto smallest = blocks_.end();
  for (auto block = blocks_.begin(); block != blocks_.end(); ++block)
    if (!block->used && (smallest == blocks_.end() || block->bytes < smallest->bytes)) smallest = block;
  if (smallest == blocks_.end()) return false;
  ::operator delete(smallest->memory, kAlignment);
  held_ -= smallest->bytes;
  blocks_.erase(smallest);
  return true;
}

std::size_t FieldMemory::held() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return held_;
}

FieldMemory& fieldMemory() {
  static FieldMemory memory;
  return memory;
}

}  // namespace dense_fusion
