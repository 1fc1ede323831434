#include "zmssd_kernel.h"

#include <algorithm>
#include <limits>

// Compiled with -O3 -fopenmp-simd (CMakeLists.txt): the loops below vectorise, the gathers included.
#define HEIGHTMAP_MCL_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))

namespace heightmap_mcl::kernel {

HEIGHTMAP_MCL_CLONES
OverlapSums overlapSums(const float* x, const float* y, const float* h, int n, float c, float s, float tx, float ty,
                        const GroundView& ground) {
  // The border of holes lets us clamp instead of test: whatever lies outside lands on a hole.
  const float max_column = static_cast<float>(ground.width) - 0.5f, max_row = static_cast<float>(ground.height) - 0.5f;
  const float* heights = ground.heights;
  const int width = ground.width;
  OverlapSums total;
  constexpr int kBlock = 4096;  // floats accumulate over a block only
  for (int begin = 0; begin < n; begin += kBlock) {
    const int end = std::min(begin + kBlock, n);
    float count = 0, d1 = 0, d2 = 0, a1 = 0, a2 = 0, g2 = 0;
#pragma omp simd reduction(+ : count, d1, d2, a1, a2, g2)
    for (int i = begin; i < end; ++i) {
      float column = c * x[i] - s * y[i] + tx;
      float row = s * x[i] + c * y[i] + ty;
      column = column > 0.f ? column : 0.f;
      column = column < max_column ? column : max_column;
      row = row > 0.f ? row : 0.f;
      row = row < max_row ? row : max_row;
      const float g = heights[static_cast<int>(row) * width + static_cast<int>(column)];
      const bool known = g == g;
      const float a = known ? h[i] : 0.f, below = known ? g : 0.f, d = a - below;
      count += known ? 1.f : 0.f;
      d1 += d;
      d2 += d * d;
      a1 += a;
      a2 += a * a;
      g2 += below * below;
    }
    total.n += count;
    total.d += d1;
    total.d2 += d2;
    total.a += a1;
    total.a2 += a2;
    total.g2 += g2;
  }
  return total;
}

HEIGHTMAP_MCL_CLONES
void correlate(const float* const air[3], const float* const ground[3], int n, float* const out[6]) {
  const float *a0 = air[0], *a1 = air[1], *a2 = air[2], *g0 = ground[0], *g1 = ground[1], *g2 = ground[2];
  float *count = out[0], *d = out[1], *dd = out[2], *a = out[3], *aa = out[4], *gg = out[5];
#pragma omp simd
  for (int i = 0; i < 2 * n; i += 2) {
    const float a0r = a0[i], a0i = a0[i + 1], a1r = a1[i], a1i = a1[i + 1], a2r = a2[i], a2i = a2[i + 1];
    const float g0r = g0[i], g0i = g0[i + 1], g1r = g1[i], g1i = g1[i + 1], g2r = g2[i], g2i = g2[i + 1];
    // conj(a) g = (ar gr + ai gi) + i (ar gi - ai gr)
    const float ar = a1r * g0r + a1i * g0i, ai = a1r * g0i - a1i * g0r;
    const float aar = a2r * g0r + a2i * g0i, aai = a2r * g0i - a2i * g0r;
    const float ggr = a0r * g2r + a0i * g2i, ggi = a0r * g2i - a0i * g2r;
    count[i] = a0r * g0r + a0i * g0i;
    count[i + 1] = a0r * g0i - a0i * g0r;
    d[i] = ar - (a0r * g1r + a0i * g1i);
    d[i + 1] = ai - (a0r * g1i - a0i * g1r);
    dd[i] = aar + ggr - 2.f * (a1r * g1r + a1i * g1i);
    dd[i + 1] = aai + ggi - 2.f * (a1r * g1i - a1i * g1r);
    a[i] = ar;
    a[i + 1] = ai;
    aa[i] = aar;
    aa[i + 1] = aai;
    gg[i] = ggr;
    gg[i + 1] = ggi;
  }
}

HEIGHTMAP_MCL_CLONES
void scoreRow(const float* const sums[6], int n, float scale, float cells, const CostSettings& settings, float* score) {
  constexpr float infinity = std::numeric_limits<float>::infinity();
  const float *counts = sums[0], *d1 = sums[1], *d2 = sums[2], *a1 = sums[3], *a2 = sums[4], *g2 = sums[5];
  const auto min_cells = static_cast<float>(settings.min_overlap) * cells;
  const auto unknown_cost = static_cast<float>(settings.unknown_cost);
  // Without min_explained the trust is 1 everywhere.
  const float trusted = settings.min_explained > 0 ? 0.f : 1.f;
  const auto per_explained = static_cast<float>(settings.min_explained > 0 ? 1 / settings.min_explained : 0);
  const auto least = static_cast<float>(std::max(settings.min_relief * settings.min_relief, 1e-12));
#pragma omp simd
  for (int i = 0; i < n; ++i) {
    // The count is a whole number; adding and removing 1.5 * 2^23 rounds to it.
    const float count = (counts[i] * scale + 12582912.f) - 12582912.f;
    const float per_cell = scale / (count > 1.f ? count : 1.f);
    const float d = d1[i] * per_cell, a = a1[i] * per_cell, g = a - d;
    const float difference = d2[i] * per_cell - d * d, air = a2[i] * per_cell - a * a,
                ground = g2[i] * per_cell - g * g;
    const float twice_cost = difference > 0.f ? difference : 0.f;
    float most = air > ground ? air : ground;
    most = most > least ? most : least;
    float trust = trusted + (1.f - twice_cost / most) * per_explained;
    trust = trust > 0.f ? trust : 0.f;
    trust = trust < 1.f ? trust : 1.f;
    const float share = count / cells;
    const float value = 0.5f * twice_cost + unknown_cost * (1.f - trust * (share < 1.f ? share : 1.f));
    score[i] = count >= min_cells && count >= 1.f ? value : infinity;
  }
}

}  // namespace heightmap_mcl::kernel
