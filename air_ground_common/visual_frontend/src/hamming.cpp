#include "hamming.h"

#include <cstring>

#include "air_ground_common/clones.h"

namespace visual_frontend {

// "avx2" brings the popcnt instruction with it.
AIR_GROUND_CLONES_FOR("avx2", "default")
void nearestHamming(const std::uint8_t* a, std::size_t stride_a, int n_a, const std::uint8_t* b, std::size_t stride_b,
                    int n_b, int* nearest, int* distance, int* second) {
  for (int i = 0; i < n_a; ++i) {
    std::uint64_t x[4];
    std::memcpy(x, a + i * stride_a, 32);
    int best = -1, best_distance = 257, second_distance = 257;
    for (int j = 0; j < n_b; ++j) {
      std::uint64_t y[4];
      std::memcpy(y, b + j * stride_b, 32);
      const int d = __builtin_popcountll(x[0] ^ y[0]) + __builtin_popcountll(x[1] ^ y[1]) +
                    __builtin_popcountll(x[2] ^ y[2]) + __builtin_popcountll(x[3] ^ y[3]);
      if (d < best_distance) {
        second_distance = best_distance;
        best_distance = d;
        best = j;
      } else if (d < second_distance) {
        second_distance = d;
      }
    }
    nearest[i] = best;
    distance[i] = best_distance;
    second[i] = second_distance;
  }
}

}  // namespace visual_frontend
