// Distances of 256-bit descriptors.
#pragma once

#include <cstddef>
#include <cstdint>

namespace visual_frontend {

/// For each of n_a descriptors (rows of 32 bytes, `stride_a` apart): nearest of b, its distance, and the second
/// distance. Distances of 257 mean none. Arrays hold n_a entries.
void nearestHamming(const std::uint8_t* a, std::size_t stride_a, int n_a, const std::uint8_t* b, std::size_t stride_b,
                    int n_b, int* nearest, int* distance, int* second);

}  // namespace visual_frontend
