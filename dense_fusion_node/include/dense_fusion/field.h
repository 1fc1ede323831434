// Arrays of a value a voxel.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace dense_fusion {

/// Large arrays in large pages: a volume of 13 million floats is 13,000 pages of 4 KiB, whose faults took longer than
/// the work on them. Elements that are not given a value stay as they are in memory.
template <typename T>
struct FieldAllocator : std::allocator<T> {
  template <typename U>
  struct rebind {
    using other = FieldAllocator<U>;
  };
  static constexpr std::size_t kPage = std::size_t{1} << 21;

  static bool large(std::size_t n) { return n * sizeof(T) >= 2 * kPage; }
  T* allocate(std::size_t n) {
    if (!large(n)) return std::allocator<T>().allocate(n);
    void* memory = ::operator new (n * sizeof(T), std::align_val_t{kPage});
    madvise(memory, n * sizeof(T), MADV_HUGEPAGE);  // where the kernel has none, small ones do
    return static_cast<T*>(memory);
  }
  void deallocate(T* memory, std::size_t n) {
    if (large(n))
      ::operator delete (memory, std::align_val_t{kPage});
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
