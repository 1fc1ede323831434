// Memory that runs out at a chosen allocation. Replaces operator new: include it in one file of a program.
#pragma once

#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>

namespace air_ground_common::testing {
inline std::atomic<long> allocations_left{-1};  // the one that finds 0 fails; below 0 none does
}

// Not inlined: the compiler would take malloc and delete, or new and free, for a mismatch.
__attribute__((noinline)) void* operator new(std::size_t size) {
  auto& left = air_ground_common::testing::allocations_left;
  if (left >= 0 && left-- == 0) throw std::bad_alloc();
  if (void* memory = std::malloc(size == 0 ? 1 : size)) return memory;
  throw std::bad_alloc();
}
__attribute__((noinline)) void operator delete(void* memory) noexcept { std::free(memory); }
__attribute__((noinline)) void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace air_ground_common::testing {

/// Runs `job` with the first allocation failing, then with a later one, and so on, until it needs no more than there
/// is. How often it threw: each time it must.
template <typename Job>
int failuresWithoutMemory(const Job& job) {
  int thrown = 0;
  for (long fails = 0;; fails += 1 + fails / 16) {
    allocations_left = fails;
    try {
      job();
      const bool had_enough = allocations_left.exchange(-1) >= 0;
      if (had_enough) return thrown;
      ADD_FAILURE() << "allocation " << fails << " failed, and nobody was told";
      return thrown;
    } catch (const std::bad_alloc&) {
      allocations_left = -1;
      ++thrown;
    }
  }
}

}  // namespace air_ground_common::testing
