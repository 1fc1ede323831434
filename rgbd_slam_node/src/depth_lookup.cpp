#include "depth_lookup.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "air_ground_common/clones.h"

namespace rgbd_slam {
namespace {

constexpr float kSameSurface = 0.05f;  // of neighbouring depths, relative: between others there is an edge
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr int kChunk = 64;  // places worked on at once, so that their operands stay in the first-level cache

}  // namespace

float depthAt(const DepthImage& depth, float x, float y) {
  if (!(x >= 0 && y >= 0 && x <= static_cast<float>(depth.width - 1) && y <= static_cast<float>(depth.height - 1)))
    return kNaN;
  const int u = std::min(static_cast<int>(x), depth.width - 2), v = std::min(static_cast<int>(y), depth.height - 2);
  const float *upper = depth.data + v * depth.stride + u, *lower = upper + depth.stride;
  const float a = upper[0], b = upper[1], c = lower[0], d = lower[1];
  const float right = x - static_cast<float>(u), down = y - static_cast<float>(v);
  const float least = std::min(std::min(a, b), std::min(c, d)), most = std::max(std::max(a, b), std::max(c, d));
  // Sums and products with NaN are NaN, comparisons false.
  if (least > 0 && most - least < kSameSurface * least && std::isfinite(a + b + c + d))
    return (1 - down) * (a + right * (b - a)) + down * (c + right * (d - c));
  return (down < 0.5f ? upper : lower)[right < 0.5f ? 0 : 1];
}

AIR_GROUND_CLONES
void depthsAt(const DepthImage& depth, const float* x, const float* y, int n, float* out) {
  alignas(64) std::int32_t at[kChunk];
  alignas(64) float right[kChunk], down[kChunk], outside[kChunk], a[kChunk], b[kChunk], c[kChunk], d[kChunk];
  const float last_x = static_cast<float>(depth.width - 1), last_y = static_cast<float>(depth.height - 1);
  for (int begin = 0; begin < n; begin += kChunk) {
    const int count = std::min(kChunk, n - begin);
    for (int i = 0; i < count; ++i) {
      const float px = x[begin + i], py = y[begin + i];
      const float in_x = std::min(std::max(0.F, px), last_x), in_y = std::min(std::max(0.F, py), last_y);
      const int u = std::min(static_cast<int>(in_x), depth.width - 2),
                v = std::min(static_cast<int>(in_y), depth.height - 2);
      at[i] = v * static_cast<int>(depth.stride) + u;
      right[i] = in_x - static_cast<float>(u);
      down[i] = in_y - static_cast<float>(v);
      outside[i] = (in_x == px) & (in_y == py) ? 0.F : kNaN;
    }
    for (int i = 0; i < count; ++i) {
      const float *upper = depth.data + at[i], *lower = upper + depth.stride;
      a[i] = upper[0];
      b[i] = upper[1];
      c[i] = lower[0];
      d[i] = lower[1];
    }
    for (int i = 0; i < count; ++i) {
      const float p = a[i], q = b[i], r = c[i], s = d[i], by_x = right[i], by_y = down[i];
      const float least = std::min(std::min(p, q), std::min(r, s)), most = std::max(std::max(p, q), std::max(r, s));
      const float between = (1 - by_y) * (p + by_x * (q - p)) + by_y * (r + by_x * (s - r));
      const float upper = by_x < 0.5f ? p : q, lower = by_x < 0.5f ? r : s;
      const float nearest = by_y < 0.5f ? upper : lower;
      // The last: 0 where all four are finite.
      const bool same = (least > 0) & (most - least < kSameSurface * least) & ((p + q + r + s) * 0 == 0);
      out[begin + i] = (same ? between : nearest) + outside[i];
    }
  }
}

}  // namespace rgbd_slam
