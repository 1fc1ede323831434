// Squared distances of byte descriptors on plain arrays; compiled for several instruction sets, the best is chosen at
// run time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace streetview_localizer {

constexpr int kDescriptorSize = 128;
constexpr int kLanes = 16;  // descriptors side by side in a packed block

/// Descriptors in blocks of 16, four bytes of each in turn, as the multiply-add instructions want them.
struct PackedDescriptors {
  int count = 0;
  int blocks = 0;
  std::vector<std::uint8_t> bytes;         ///< block, group of 4 elements, lane, element; padded with zeros
  std::vector<std::int32_t> squared_norm;  ///< of each, padded with a large number
  std::vector<std::int32_t> shift;         ///< 256 times the sum of each
};

PackedDescriptors packDescriptors(const std::uint8_t* rows, int count, std::size_t stride);

enum class Simd { kNone, kAvx2, kAvx512Vnni };
bool isSupported(Simd simd);
Simd bestSimd();

/// out[q * 16 * packed.blocks + j] = |query_q - packed_j|^2 for q < 4. `query`: 4 rows of 128 bytes, `stride` bytes
/// apart.
void distancesOfFour(const std::uint8_t* query, std::size_t stride, const PackedDescriptors& packed, std::int32_t* out,
                     Simd simd = bestSimd());

/// The squared distance of two descriptors: what distancesOfFour computes, plainly.
std::int32_t squaredDistance(const std::uint8_t* a, const std::uint8_t* b);

/// Smallest of values[0..count), and the first index that has it; count > 0.
void minimumOf(const std::int32_t* values, int count, std::int32_t* minimum, int* index);

/// Smallest of values[j] with (x[j] - x0)^2 + (y[j] - y0)^2 > r2; INT32_MAX when there is none. Once one below `enough`
/// is found, any such value may be returned.
std::int32_t minimumElsewhere(const std::int32_t* values, const float* x, const float* y, int count, float x0, float y0,
                              float r2, std::int32_t enough = INT32_MIN);

/// best[j] = min(best[j], values[j]), and owner[j] = id where values[j] was smaller.
void lowerColumns(const std::int32_t* values, int count, std::int32_t id, std::int32_t* best, std::int32_t* owner);

}  // namespace streetview_localizer
