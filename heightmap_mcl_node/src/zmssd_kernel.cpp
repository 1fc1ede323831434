#include "zmssd_kernel.h"

#include <algorithm>
#include <cstdint>
#include <limits>

#include "air_ground_common/clones.h"

// Compiled with -O3 -fopenmp-simd (CMakeLists.txt): the loops below vectorise.

namespace heightmap_mcl::kernel {

namespace {

constexpr int kBlock = 512;  // cells: what one step leaves to the next stays in the first-level cache

/// An aerial cell and the ground cell that it comes to lie on; 1 or 0 for what is so or not.
struct Pair {
  float partner;  // whether there is a ground cell
  float g;        // ground height or bound; 0 without partner
  float known;    // heights in both, no edge near
  float lack;     // what the ground lacks of the least that the aerial height may be, or the greatest of the ground's
};

// One by one, which takes less than half of the time of the loads that a vectorised loop makes of it.
[[gnu::noinline, gnu::optimize("no-tree-vectorize")]] void fetch(const float* from, const std::int32_t* at, int n,
                                                                 float* __restrict to) {
#pragma GCC unroll 8
  for (int i = 0; i < n; ++i) to[i] = from[at[i]];
}

// Heights of the ground cells (see GroundView) on which the aerial ones from `begin` on come to lie.
[[gnu::always_inline]] inline void groundUnder(const AirView& air, int begin, int n, const ToCells& to,
                                               const GroundView& ground, float* heights) {
  // The border of holes lets us clamp instead of test: whatever lies outside lands on a hole.
  const float max_column = static_cast<float>(ground.width) - 0.5f, max_row = static_cast<float>(ground.height) - 0.5f;
  const float *x = air.x + begin, *y = air.y + begin;
  alignas(64) std::int32_t cell[kBlock];
#pragma omp simd
  for (int i = 0; i < n; ++i) {
    float column = to.c * x[i] - to.s * y[i] + to.x0;
    float row = to.s * x[i] + to.c * y[i] + to.y0;
    column = column > 0.f ? column : 0.f;
    column = column < max_column ? column : max_column;
    row = row > 0.f ? row : 0.f;
    row = row < max_row ? row : max_row;
    cell[i] = static_cast<std::int32_t>(row) * ground.width + static_cast<std::int32_t>(column);
  }
  fetch(ground.heights, cell, n, heights);
}

// Part of loops that vectorise, in each of the clones. `value`: of GroundView.
[[gnu::always_inline]] inline Pair pairOf(float low, float high, float value) {
  Pair pair;
  pair.partner = value == value ? 1.f : 0.f;
  const float height = value == value ? value : 0.f;
  const float ground_bound = height > 0.5f * kBoundOffset ? 1.f : 0.f;
  pair.g = height - ground_bound * kBoundOffset;
  pair.known = low == high ? 1.f - ground_bound : 0.f;
  const float above = (1.f - ground_bound) * (low - pair.g), below = pair.g - high;
  const float lack = above > below ? above : below;
  pair.lack = lack > 0.f ? lack : 0.f;
  return pair;
}

}  // namespace

AIR_GROUND_CLONES
OverlapSums overlapSums(const AirView& air, const ToCells& to_cells, const GroundView& ground) {
  const ToCells to = to_cells;
  const GroundView map = ground;
  alignas(64) float under[kBlock];
  OverlapSums total;
  for (int begin = 0; begin < air.n; begin += kBlock) {
    const int n = std::min(kBlock, air.n - begin);
    groundUnder(air, begin, n, to, map, under);
    const float *h = air.h + begin, *low = air.low + begin, *high = air.high + begin;
    float count = 0, both = 0, d1 = 0, d2 = 0, a1 = 0, a2 = 0, g1 = 0, g2 = 0;
#pragma omp simd reduction(+ : count, both, d1, d2, a1, a2, g1, g2)
    for (int i = 0; i < n; ++i) {
      const Pair pair = pairOf(low[i], high[i], under[i]);
      const float g = pair.g, a = pair.partner * h[i], known = pair.partner * pair.known;
      const float d = a - g, known_d = known * d, lack = (pair.partner - known) * pair.lack;
      count += pair.partner;
      both += known;
      d1 += known_d;
      d2 += known_d * d + lack * lack;
      a1 += a;
      a2 += a * a;
      g1 += g;
      g2 += g * g;
    }
    total.n += count;
    total.known += both;
    total.d += d1;
    total.d2 += d2;
    total.a += a1;
    total.a2 += a2;
    total.g += g1;
    total.g2 += g2;
  }
  return total;
}

AIR_GROUND_CLONES
AgreementSums agreementSums(const AirView& air, const ToCells& to_cells, const GroundView& ground,
                            const AgreementLimits& limits) {
  const ToCells to = to_cells;
  const GroundView map = ground;
  const AgreementLimits limit = limits;
  alignas(64) float under[kBlock];
  AgreementSums total;
  for (int begin = 0; begin < air.n; begin += kBlock) {
    const int n = std::min(kBlock, air.n - begin);
    groundUnder(air, begin, n, to, map, under);
    const float *h = air.h + begin, *low = air.low + begin, *high = air.high + begin;
    float count = 0, squares = 0, up = 0, up_agree = 0, inliers = 0, d1 = 0;
#pragma omp simd reduction(+ : count, squares, up, up_agree, inliers, d1)
    for (int i = 0; i < n; ++i) {
      const Pair pair = pairOf(low[i], high[i], under[i]);
      const float d = h[i] - pair.g;
      float residual = d - limit.offset;
      residual = residual > 0.f ? residual : -residual;
      residual = pair.known > 0.f ? residual : pair.lack;
      const float inlier = residual < limit.cutoff ? pair.partner * pair.known : 0.f;
      const float most = low[i] > pair.g ? low[i] : pair.g;
      const float standing = most > limit.raised ? pair.partner : 0.f;
      up += standing;
      up_agree += residual < limit.agreeing ? standing : 0.f;
      residual = residual < limit.cutoff ? residual : limit.cutoff;
      count += pair.partner;
      squares += pair.partner * residual * residual;
      inliers += inlier;
      d1 += inlier * d;
    }
    total.n += count;
    total.squares += squares;
    total.raised += up;
    total.agree += up_agree;
    total.inliers += inliers;
    total.d += d1;
  }
  return total;
}

AIR_GROUND_CLONES
void correlate(const MapSpectra& air_known, const MapSpectra& air_all, const MapSpectra& ground_known,
               const MapSpectra& ground_all, int n, bool bounds, bool opposite, float* const out[kSums]) {
  const float turn = opposite ? -1.f : 1.f;
  const float *a0 = air_known.mask, *a1 = air_known.h, *a2 = air_known.h2;
  const float *g0 = ground_known.mask, *g1 = ground_known.h, *g2 = ground_known.h2;
  float *count = out[0], *known = out[1], *d = out[2], *dd = out[3];
#pragma omp simd
  for (int i = 0; i < 2 * n; i += 2) {
    const float a0r = a0[i], a0i = turn * a0[i + 1], a1r = a1[i], a1i = turn * a1[i + 1];
    const float a2r = a2[i], a2i = turn * a2[i + 1];
    const float g0r = g0[i], g0i = g0[i + 1], g1r = g1[i], g1i = g1[i + 1], g2r = g2[i], g2i = g2[i + 1];
    // conj(a) g = (ar gr + ai gi) + i (ar gi - ai gr)
    count[i] = a0r * g0r + a0i * g0i;
    count[i + 1] = a0r * g0i - a0i * g0r;
    d[i] = a1r * g0r + a1i * g0i - (a0r * g1r + a0i * g1i);
    d[i + 1] = a1r * g0i - a1i * g0r - (a0r * g1i - a0i * g1r);
    dd[i] = a2r * g0r + a2i * g0i + a0r * g2r + a0i * g2i - 2.f * (a1r * g1r + a1i * g1i);
    dd[i + 1] = a2r * g0i - a2i * g0r + a0r * g2i - a0i * g2r - 2.f * (a1r * g1i - a1i * g1r);
  }
  a0 = air_all.mask, a1 = air_all.h, a2 = air_all.h2;
  g0 = ground_all.mask, g1 = ground_all.h, g2 = ground_all.h2;
  float *a = out[4], *aa = out[5], *g = out[6], *gg = out[7];
#pragma omp simd
  for (int i = 0; i < 2 * n; i += 2) {
    const float a0r = a0[i], a0i = turn * a0[i + 1], a1r = a1[i], a1i = turn * a1[i + 1];
    const float a2r = a2[i], a2i = turn * a2[i + 1], g0r = g0[i], g0i = g0[i + 1];
    a[i] = a1r * g0r + a1i * g0i;
    a[i + 1] = a1r * g0i - a1i * g0r;
    aa[i] = a2r * g0r + a2i * g0i;
    aa[i + 1] = a2r * g0i - a2i * g0r;
    gg[i] = a0r * g2[i] + a0i * g2[i + 1];
    gg[i + 1] = a0r * g2[i + 1] - a0i * g2[i];
  }
  if (!bounds) return;
#pragma omp simd
  for (int i = 0; i < 2 * n; i += 2) {
    const float a0r = a0[i], a0i = turn * a0[i + 1], g0r = g0[i], g0i = g0[i + 1];
    known[i] = count[i];
    known[i + 1] = count[i + 1];
    count[i] = a0r * g0r + a0i * g0i;
    count[i + 1] = a0r * g0i - a0i * g0r;
    g[i] = a0r * g1[i] + a0i * g1[i + 1];
    g[i + 1] = a0r * g1[i + 1] - a0i * g1[i];
  }
}

AIR_GROUND_CLONES
void addCorrelation(const float* a, const float* b, int n, bool opposite, float* out) {
  const float turn = opposite ? -1.f : 1.f;
#pragma omp simd
  for (int i = 0; i < 2 * n; i += 2) {
    const float ar = a[i], ai = turn * a[i + 1];
    out[i] += ar * b[i] + ai * b[i + 1];
    out[i + 1] += ar * b[i + 1] - ai * b[i];
  }
}

AIR_GROUND_CLONES
void addTo(const float* a, int n, float* out) {
#pragma omp simd
  for (int i = 0; i < n; ++i) out[i] += a[i];
}

AIR_GROUND_CLONES
void scoreRow(const float* const sums[kSums], int n, float scale, float cells, const CostSettings& settings,
              float* score) {
  constexpr float infinity = std::numeric_limits<float>::infinity();
  const float *counts = sums[0], *known = sums[1], *d1 = sums[2], *d2 = sums[3];
  const float *a1 = sums[4], *a2 = sums[5], *g1 = sums[6], *g2 = sums[7];
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
    const float both = (known[i] * scale + 12582912.f) - 12582912.f;
    const float per_cell = scale / (count > 1.f ? count : 1.f), per_known = scale / (both > 1.f ? both : 1.f);
    const float a = a1[i] * per_cell, g = g1[i] * per_cell;
    const float d = both > 0.f ? d1[i] : 0.f;
    const float difference = (d2[i] - d * (d * per_known)) * per_cell, air = a2[i] * per_cell - a * a,
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
