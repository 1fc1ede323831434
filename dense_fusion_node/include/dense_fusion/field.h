// Arrays of a value a voxel.
#pragma once

#include <cstddef>
#include <memory>
#include <new>
#include <utility>
#include <vector>

#include "dense_fusion/field_memory.h"

namespace dense_fusion {

/// Large arrays from fieldMemory(). Elements that are not given a value stay as they are in memory.
template <typename T>
struct FieldAllocator : std::allocator<T> {
  template <typename U>
  struct rebind {
    using other = FieldAllocator<U>;
  };

  static bool large(std::size_t n) { return n * sizeof(T) >= 2 * FieldMemory::kPage; }
  T* allocate(std::size_t n) {
    return large(n) ? static_cast<T*>(fieldMemory().take(n * sizeof(T))) : std::allocator<T>().allocate(n);
  }
  void deallocate(T* memory, std::size_t n) {
    if (large(n))
      fieldMemory().giveBack(memory);
    else
      std::allocator<T>().deallocate(memory, n);
  }
  template <typename U>
  void construct(U* element) {
    ::new (static_cast<void*>(element)) U;
  }
  template <typename U, typename... Args>
  void construct(U* element, Args&&... args) {
    ::new (static_cast<void*>(element)) U(std::forward<Args>(args)...);
  }
};

template <typename T>
using Field = std::vector<T, FieldAllocator<T>>;

}  // namespace dense_fusion
