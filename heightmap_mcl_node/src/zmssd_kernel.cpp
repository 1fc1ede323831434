#include "zmssd_kernel.h"

#include <algorithm>
#include <limits>

// Compiled with -O3 -fopenmp-simd (CMakeLists.txt): the loops below vectorise, the gathers included.
#define HEIGHTMAP_MCL_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))

namespace heightmap_mcl::kernel {

HEIGHTMAP_MCL_CLONES
Sums differences(const float* x, const float* y, const float* h, int n, float c, float s, float tx, float ty,
                 const GroundView& ground) {
  // The border of holes lets us clamp instead of test: whatever lies outside lands on a hole.
  const float max_column = static_cast<float>(ground.width) - 0.5f, max_row = static_cast<float>(ground.height) - 0.5f;
  const float* heights = ground.heights;
  const int width = ground.width;
  Sums total{0, 0, 0};
  constexpr int kBlock = 4096;  // floats accumulate over a block only
  for (int begin = 0; begin < n; begin += kBlock) {
    const int end = std::min(begin + kBlock, n);
    float count = 0, sum = 0, squares = 0;
#pragma omp simd reduction(+ : count, sum, squares)
    for (int i = begin; i < end; ++i) {
      float column = c * x[i] - s * y[i] + tx;
      float row = s * x[i] + c * y[i] + ty;
      column = column > 0.f ? column : 0.f;
      column = column < max_column ? column : max_column;
      row = row > 0.f ? row : 0.f;
      row = row < max_row ? row : max_row;
      const float g = heights[static_cast<int>(row) * width + static_cast<int>(column)];
      const float d = g == g ? h[i] - g : 0.f;
      count += g == g ? 1.f : 0.f;
      sum += d;
      squares += d * d;
    }
    total.n += count;
    total.sum += sum;
    total.squares += squares;
  }
  return total;
}

HEIGHTMAP_MCL_CLONES
void correlate(const float* a0, const float* a1, const float* a2, const float* g0, const float* g1, const float* g2, int n,
               float* n_out, float* s1_out, float* s2_out) {
#pragma omp simd
  for (int i = 0; i < n; ++i) {
    const float a0r = a0[2 * i], a0i = a0[2 * i + 1], a1r = a1[2 * i], a1i = a1[2 * i + 1];
    const float a2r = a2[2 * i], a2i = a2[2 * i + 1];
    const float g0r = g0[2 * i], g0i = g0[2 * i + 1], g1r = g1[2 * i], g1i = g1[2 * i + 1];
    const float g2r = g2[2 * i], g2i = g2[2 * i + 1];
    // conj(a) g = (ar gr + ai gi) + i (ar gi - ai gr)
    n_out[2 * i] = a0r * g0r + a0i * g0i;
    n_out[2 * i + 1] = a0r * g0i - a0i * g0r;
    s1_out[2 * i] = (a1r * g0r + a1i * g0i) - (a0r * g1r + a0i * g1i);
    s1_out[2 * i + 1] = (a1r * g0i - a1i * g0r) - (a0r * g1i - a0i * g1r);
    s2_out[2 * i] = (a2r * g0r + a2i * g0i) + (a0r * g2r + a0i * g2i) - 2.f * (a1r * g1r + a1i * g1i);
    s2_out[2 * i + 1] = (a2r * g0i - a2i * g0r) + (a0r * g2i - a0i * g2r) - 2.f * (a1r * g1i - a1i * g1r);
  }
}

HEIGHTMAP_MCL_CLONES
void costRow(const float* n_in, const float* s1_in, const float* s2_in, int n, float scale, float min_cells,
             float smaller_cells, float unknown_cost, float* cost) {
  constexpr float infinity = std::numeric_limits<float>::infinity();
#pragma omp simd
  for (int i = 0; i < n; ++i) {
    // N is a whole number; adding and removing 1.5 * 2^23 rounds to it.
    const float count = (n_in[i] * scale + 12582912.f) - 12582912.f;
    const float safe = count > 1.f ? count : 1.f;
    const float s1 = s1_in[i] * scale;
    const float spread = s2_in[i] * scale - s1 * s1 / safe;
    const float value = (spread > 0.f ? spread : 0.f) / (2.f * safe) + unknown_cost * (1.f - safe / smaller_cells);
    cost[i] = count >= min_cells && count >= 1.f ? value : infinity;
  }
}

}  // namespace heightmap_mcl::kernel
