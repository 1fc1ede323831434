#include "dense_fusion/fusion_kernels.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/clones.h"
#include "dense_fusion/histogram.h"

namespace dense_fusion::kernels {

AIR_GROUND_CLONES
void voteRow(const float* start, const float* step, int nx, const float* camera, const float* __restrict depth,
             int width, int height, float inverse_truncation, float lowest, std::uint8_t* __restrict bin) {
  const float fx = camera[0], fy = camera[1], cx = camera[2] + 0.5f, cy = camera[3] + 0.5f;
  const float X0 = start[0], Y0 = start[1], Z0 = start[2], dX = step[0], dY = step[1], dZ = step[2];
  const float right = static_cast<float>(width), bottom = static_cast<float>(height);
  constexpr float kHalf = 0.5f * (kBins - 1);
  for (int x = 0; x < nx; ++x) {
    const float i = static_cast<float>(x);
    const float X = X0 + i * dX, Y = Y0 + i * dY, Z = Z0 + i * dZ;
    const float inverse_z = 1.f / std::max(Z, 1e-3f);
    const float u = fx * X * inverse_z + cx,
                v = fy * Y * inverse_z + cy;  // +0.5: truncation rounds to the nearest pixel
    const int inside = (u >= 0.f) & (v >= 0.f) & (u < right) & (v < bottom) & (Z > 1e-3f);
    // In this order NaN, of depth too, becomes the lower bound.
    const int iu = static_cast<int>(std::min(std::max(0.f, u), right - 1.f));
    const int iv = static_cast<int>(std::min(std::max(0.f, v), bottom - 1.f));
    const float f = (depth[iv * width + iu] - Z) * inverse_truncation;
    const int voted = inside & (f >= lowest);  // false for NaN depth
    const int k = static_cast<int>(std::min(std::max(-1.f, f), 1.f) * kHalf + (kHalf + 0.5f));
    bin[x] = static_cast<std::uint8_t>(voted ? k : 255);
  }
}

AIR_GROUND_CLONES
void countRow(const std::uint8_t* bin, int n, std::uint8_t* counts, int stride) {
  // Neighbours mostly vote alike: counts of bins that nobody votes for are not even read.
  constexpr int kTogether = 128;
  for (int begin = 0; begin < n; begin += kTogether) {
    const int end = std::min(n, begin + kTogether);
    std::uint8_t lowest = 255, above = 0;  // above the highest; 255, no vote, wraps to 0
    for (int x = begin; x < end; ++x) {
      lowest = std::min(lowest, bin[x]);
      above = std::max(above, static_cast<std::uint8_t>(bin[x] + 1));
    }
    for (int k = lowest; k < above; ++k) {
      std::uint8_t* c = counts + static_cast<std::ptrdiff_t>(k) * stride;
      // Votes are alike in the next row, too, whose counts lie behind those of this one.
      for (int x = begin; x < end; x += 64) __builtin_prefetch(c + x + static_cast<std::ptrdiff_t>(kBins) * stride, 1);
      for (int x = begin; x < end; ++x) {
        const std::uint8_t vote = bin[x] == k ? 1 : 0, room = static_cast<std::uint8_t>(~c[x]);
        c[x] = static_cast<std::uint8_t>(c[x] + std::min(vote, room));
      }
    }
  }
}

AIR_GROUND_CLONES
bool dualRow(const float* __restrict ubar, const float* __restrict ubar_y, const float* __restrict ubar_z,
             float* __restrict px, float* __restrict py, float* __restrict pz, int n, bool at_border, float sigma) {
  int changed = 0;
  const int inner = at_border ? n - 1 : n;
  for (int x = 0; x < inner; ++x) {
    const float qx = px[x] + sigma * (ubar[x + 1] - ubar[x]);
    const float qy = py[x] + sigma * (ubar_y[x] - ubar[x]);
    const float qz = pz[x] + sigma * (ubar_z[x] - ubar[x]);
    const float scale = 1.f / std::sqrt(std::max(1.f, qx * qx + qy * qy + qz * qz));
    const float new_x = qx * scale, new_y = qy * scale, new_z = qz * scale;
    changed |= (new_x != px[x]) | (new_y != py[x]) | (new_z != pz[x]);
    px[x] = new_x;
    py[x] = new_y;
    pz[x] = new_z;
  }
  if (at_border) {
    const int last = n - 1;
    const float qy = py[last] + sigma * (ubar_y[last] - ubar[last]);
    const float qz = pz[last] + sigma * (ubar_z[last] - ubar[last]);
    const float scale = 1.f / std::sqrt(std::max(1.f, qy * qy + qz * qz));
    const float new_y = qy * scale, new_z = qz * scale;
    changed |= (px[last] != 0) | (new_y != py[last]) | (new_z != pz[last]);
    px[last] = 0;
    py[last] = new_y;
    pz[last] = new_z;
  }
  return changed != 0;
}

namespace {

// Minimiser of (u - v)^2 / (2 tau) + lambda sum_k n_k |u - c_k|: the median of the bin centres and of
// P_i = v + tau lambda (N - 2 sum_{k <= i} n_k), i = 0..K, here by u = max(P_K, max_i min(c_i, P_{i-1})).
// `weight` is tau lambda, `n` the voxel's first count, the next ones lie kLane apart.
constexpr int kLane = 128;  // voxels worked on at once
__attribute__((always_inline)) inline float proximalStep(float v, const float* n, float weight) {
  const float n0 = n[0], n1 = n[kLane], n2 = n[2 * kLane], n3 = n[3 * kLane], n4 = n[4 * kLane], n5 = n[5 * kLane],
              n6 = n[6 * kLane], n7 = n[7 * kLane];
  const float w2 = 2.f * weight;
  const float P0 = v + weight * (((n0 + n1) + (n2 + n3)) + ((n4 + n5) + (n6 + n7)));
  const float P1 = P0 - w2 * n0, P2 = P1 - w2 * n1, P3 = P2 - w2 * n2, P4 = P3 - w2 * n3, P5 = P4 - w2 * n4,
              P6 = P5 - w2 * n5, P7 = P6 - w2 * n6, P8 = P7 - w2 * n7;
  float u = std::max(P8, std::min(binCenter(0), P0));
  u = std::max(u, std::min(binCenter(1), P1));
  u = std::max(u, std::min(binCenter(2), P2));
  u = std::max(u, std::min(binCenter(3), P3));
  u = std::max(u, std::min(binCenter(4), P4));
  u = std::max(u, std::min(binCenter(5), P5));
  u = std::max(u, std::min(binCenter(6), P6));
  u = std::max(u, std::min(binCenter(7), P7));
  return std::min(1.f, std::max(-1.f, u));
}

template <typename Count>
__attribute__((always_inline)) inline bool primalRowImpl(float* __restrict u, float* __restrict ubar,
                                                         const float* __restrict px, const float* __restrict py,
                                                         const float* __restrict py_before, const float* __restrict pz,
                                                         const float* __restrict pz_before,
                                                         const Count* __restrict counts, int stride, int n,
                                                         bool at_border, float tau, float lambda) {
  const float weight = tau * lambda;
  // Lanes of one width: bytes and floats in one loop would need more registers than there are.
  alignas(64) float px_before[kLane], numbers[kBins * kLane];
  int changed = 0;
  for (int begin = 0; begin < n; begin += kLane) {
    const int m = std::min(kLane, n - begin);
    px_before[0] = begin == 0 && at_border ? 0.f : px[begin - 1];
    std::copy_n(px + begin, m - 1, px_before + 1);
    if (!counts) {
      for (int i = 0; i < m; ++i) {
        const int x = begin + i;
        const float divergence = px[x] - px_before[i] + py[x] - py_before[x] + pz[x] - pz_before[x];
        const float next = std::min(1.f, std::max(-1.f, u[x] + tau * divergence));
        const float next_bar = 2.f * next - u[x];
        changed |= (next != u[x]) | (next_bar != ubar[x]);
        ubar[x] = next_bar;
        u[x] = next;
      }
      continue;
    }
    for (int k = 0; k < kBins; ++k) {
      const Count* of_bin = counts + static_cast<std::ptrdiff_t>(k) * stride + begin;
      for (int i = 0; i < m; ++i) numbers[k * kLane + i] = static_cast<float>(of_bin[i]);
    }
    for (int i = 0; i < m; ++i) {
      const int x = begin + i;
      const float divergence = px[x] - px_before[i] + py[x] - py_before[x] + pz[x] - pz_before[x];
      const float next = proximalStep(u[x] + tau * divergence, numbers + i, weight);
      const float next_bar = 2.f * next - u[x];
      changed |= (next != u[x]) | (next_bar != ubar[x]);
      ubar[x] = next_bar;
      u[x] = next;
    }
  }
  return changed != 0;
}

}  // namespace

AIR_GROUND_CLONES
bool primalRow(float* u, float* ubar, const float* px, const float* py, const float* py_before, const float* pz,
               const float* pz_before, const std::uint8_t* counts, int stride, int n, bool at_border, float tau,
               float lambda) {
  return primalRowImpl(u, ubar, px, py, py_before, pz, pz_before, counts, stride, n, at_border, tau, lambda);
}

AIR_GROUND_CLONES
bool primalRow(float* u, float* ubar, const float* px, const float* py, const float* py_before, const float* pz,
               const float* pz_before, const std::uint16_t* counts, int stride, int n, bool at_border, float tau,
               float lambda) {
  return primalRowImpl(u, ubar, px, py, py_before, pz, pz_before, counts, stride, n, at_border, tau, lambda);
}

AIR_GROUND_CLONES
void supportRow(const std::uint8_t* __restrict counts, int stride, int n, std::uint8_t* __restrict support) {
  static_assert(kBins == 8, "six inner bins are summed");
  const std::uint8_t *c1 = counts + stride, *c2 = c1 + stride, *c3 = c2 + stride, *c4 = c3 + stride, *c5 = c4 + stride,
                     *c6 = c5 + stride;
  for (int x = 0; x < n; ++x) {
    const unsigned sum = c1[x] + c2[x] + c3[x] + c4[x] + c5[x] + c6[x];
    support[x] = static_cast<std::uint8_t>(std::min(sum, 255u));
  }
}

AIR_GROUND_CLONES
void signChanges(const float* __restrict u, const float* __restrict next_y, const float* __restrict next_z, int n,
                 std::uint8_t* __restrict changes) {
  for (int x = 0; x + 1 < n; ++x) {
    const int here = u[x] > 0;
    changes[x] = static_cast<std::uint8_t>((here ^ (u[x + 1] > 0)) | (here ^ (next_y[x] > 0)) << 1 |
                                           (here ^ (next_z[x] > 0)) << 2);
  }
  const int last = u[n - 1] > 0;
  changes[n - 1] = static_cast<std::uint8_t>((last ^ (next_y[n - 1] > 0)) << 1 | (last ^ (next_z[n - 1] > 0)) << 2);
}

AIR_GROUND_CLONES
void lowerTo(const float* __restrict u, int n, float* __restrict least) {
  for (int x = 0; x < n; ++x) least[x] = std::min(least[x], u[x]);
}

}  // namespace dense_fusion::kernels
