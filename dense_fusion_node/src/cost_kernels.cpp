#include "dense_fusion/cost_kernels.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/clones.h"

namespace dense_fusion::kernels {
namespace {
constexpr int kChunk = 256;        // pixels worked on at once, so that their operands stay in the first-level cache
constexpr int kVector = 16;        // 16-bit lanes; pixels are worked on by so many
constexpr float kNowhere = 1e30f;  // W of lanes beyond the last pixel: their sample is pixel (0, 0), exactly
constexpr int kFractionBits = 6;   // sample positions are rounded to 1/64 px
constexpr int kGreyBits = 7;       // fraction of a difference of grey levels: 255 << 7 fits in 16 bits
constexpr float kNodeStep = 0.5f;  // images are sampled this densely along a pixel's line of samples, at least [px]
constexpr int kMostBetween = 16;   // hypotheses from one sample to the next; rounding of their steps adds up

constexpr int kOne = 1 << kFractionBits;
constexpr int kSampleShift = 2 * kFractionBits - kGreyBits;

/// Pixels of a row, as a frame sees them. Lanes up to a multiple of kVector stand for no pixel: they differ by nothing.
struct Pixels {
  int n;
  alignas(64) float X[kChunk], Y[kChunk], W[kChunk];
  alignas(64) std::int16_t reference[kChunk];  // grey levels << kGreyBits
};

// One by one, which takes no longer than a vector's gather does.
__attribute__((noinline)) void fetch(const std::uint32_t* packed, int n, std::uint32_t* __restrict at) {
#pragma GCC unroll 8
  for (int i = 0; i < n; ++i) at[i] = packed[at[i]];
}

// (sample - reference) << kGreyBits at one hypothesis, whose shifts are s.
__attribute__((always_inline)) inline void sample(const Pixels& p, float sx, float sy, float sw,
                                                  const std::uint32_t* packed, int stride,
                                                  std::int16_t* __restrict out) {
  alignas(64) std::uint32_t pixels[kChunk], across[kChunk], down[kChunk];
  for (int i = 0; i < p.n; ++i) {
    const float scale = kOne / (p.W[i] + sw);
    const std::int32_t u = static_cast<std::int32_t>((p.X[i] + sx) * scale + 0.5f);
    const std::int32_t v = static_cast<std::int32_t>((p.Y[i] + sy) * scale + 0.5f);
    pixels[i] = static_cast<std::uint32_t>((v >> kFractionBits) * stride + (u >> kFractionBits));
    across[i] = static_cast<std::uint32_t>(u) & (kOne - 1);
    down[i] = static_cast<std::uint32_t>(v) & (kOne - 1);
  }
  fetch(packed, p.n, pixels);
  constexpr std::uint32_t kEvenBytes = 0x00ff00ff, kLow = 0xffff;
  for (int i = 0; i < p.n; ++i) {
    // Upper and lower row of the neighbourhood at once, in the halves of 32 bits.
    const std::uint32_t rows =
        (pixels[i] & kEvenBytes) * (kOne - across[i]) + (pixels[i] >> 8 & kEvenBytes) * across[i];
    const std::uint32_t sum = (rows & kLow) * (kOne - down[i]) + (rows >> 16) * down[i];
    out[i] = static_cast<std::int16_t>((sum >> kSampleShift) - static_cast<std::uint32_t>(p.reference[i]));
  }
}

// cost += min(|difference + k * delta|, 63)^2 / 4 in 16-bit lanes.
__attribute__((always_inline)) inline void addSquares(int n, const std::int16_t* __restrict difference,
                                                      const std::int16_t* __restrict delta, std::int16_t k,
                                                      std::uint16_t* __restrict cost) {
  for (int i = 0; i < n; ++i) {
    const std::int16_t exact = static_cast<std::int16_t>(difference[i] + k * delta[i] + (1 << (kGreyBits - 1)));
    const std::int16_t grey = static_cast<std::int16_t>(exact >> kGreyBits);
    const std::int16_t size = std::max(grey, static_cast<std::int16_t>(-grey));
    const std::uint16_t cut = static_cast<std::uint16_t>(std::min<std::int16_t>(size, kDifferenceLimit));
    cost[i] = static_cast<std::uint16_t>(cost[i] + (static_cast<std::uint16_t>(cut * cut) >> 2));
  }
}

__attribute__((always_inline)) inline void addRowAny(const std::uint8_t* reference, int x0, int x1,
                                                     const RowOfFrame& frame, const float* inverse_depth,
                                                     int hypotheses, int between, const std::uint32_t* packed,
                                                     int stride, std::uint16_t* cost, int cost_stride) {
  Pixels p;
  alignas(64) std::int16_t delta[kChunk], samples[2][kChunk];
  const auto &base = frame.base, &step = frame.step, &shift = frame.shift;
  for (int begin = x0; begin < x1; begin += kChunk) {
    const int known = std::min(kChunk, x1 - begin);
    p.n = (known + kVector - 1) / kVector * kVector;
    for (int i = 0; i < known; ++i) {
      const float x = static_cast<float>(begin + i);
      p.X[i] = base[0] + x * step[0];
      p.Y[i] = base[1] + x * step[1];
      p.W[i] = base[2] + x * step[2];
      p.reference[i] = static_cast<std::int16_t>(reference[begin + i] << kGreyBits);
    }
    for (int i = known; i < p.n; ++i) {
      p.X[i] = p.Y[i] = 0;
      p.W[i] = kNowhere;
      p.reference[i] = static_cast<std::int16_t>((packed[0] & 255) << kGreyBits);
    }
    std::int16_t *here = samples[0], *next = samples[1];
    // (x * part + 2^14) >> 15 is one instruction (pmulhrsw); with k = 1 only the first, without the delta, is used.
    for (int d = 0, k = 0; d < hypotheses; d += k) {
      const auto sampleAt = [&](int at, std::int16_t* out) __attribute__((always_inline)) {
        const float rho = inverse_depth[at];
        sample(p, rho * shift[0], rho * shift[1], rho * shift[2], packed, stride, out);
      };
      if (d == 0) sampleAt(0, here);
      k = std::max(1, std::min(between, hypotheses - 1 - d));
      if (d + k < hypotheses) sampleAt(d + k, next);
      const std::int16_t part = static_cast<std::int16_t>(32768 / std::max(2, k));
      for (int i = 0; i < p.n; ++i) {
        const std::int16_t change = static_cast<std::int16_t>(next[i] - here[i]);
        delta[i] = static_cast<std::int16_t>((change * part + 16384) >> 15);
      }
      std::uint16_t* of_first = cost + static_cast<std::ptrdiff_t>(d) * cost_stride + (begin - x0);
      for (int j = 0; j < k; ++j)
        addSquares(p.n, here, delta, static_cast<std::int16_t>(j),
                   of_first + static_cast<std::ptrdiff_t>(j) * cost_stride);
      std::swap(here, next);
    }
  }
}

using RowAdder = decltype(&addRow);

// Not by AIR_GROUND_CLONES, which knows AVX-512 without its 16-bit lanes only.
void addRowPlain(const std::uint8_t* reference, int x0, int x1, const RowOfFrame& frame, const float* inverse_depth,
                 int hypotheses, int between, const std::uint32_t* packed, int stride, std::uint16_t* cost,
                 int cost_stride) {
  addRowAny(reference, x0, x1, frame, inverse_depth, hypotheses, between, packed, stride, cost, cost_stride);
}

#if defined(__x86_64__)
__attribute__((target("avx2"))) void addRowAvx2(const std::uint8_t* reference, int x0, int x1, const RowOfFrame& frame,
                                                const float* inverse_depth, int hypotheses, int between,
                                                const std::uint32_t* packed, int stride, std::uint16_t* cost,
                                                int cost_stride) {
  addRowAny(reference, x0, x1, frame, inverse_depth, hypotheses, between, packed, stride, cost, cost_stride);
}

__attribute__((target("avx512bw"))) void addRowAvx512(const std::uint8_t* reference, int x0, int x1,
                                                      const RowOfFrame& frame, const float* inverse_depth,
                                                      int hypotheses, int between, const std::uint32_t* packed,
                                                      int stride, std::uint16_t* cost, int cost_stride) {
  addRowAny(reference, x0, x1, frame, inverse_depth, hypotheses, between, packed, stride, cost, cost_stride);
}

#endif

RowAdder fastestRowAdder() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512bw")) return addRowAvx512;
  if (__builtin_cpu_supports("avx2")) return addRowAvx2;
#endif
  return addRowPlain;
}
}  // namespace

// Along rho a sample moves by (shift_xy W - XY shift_w) / (W + rho shift_w)^2, whose numerator does not depend on rho.
int hypothesesBetween(int x0, int x1, const RowOfFrame& frame, const float* inverse_depth, int hypotheses) {
  const auto &base = frame.base, &step = frame.step, &shift = frame.shift;
  if (hypotheses < 2 || x1 <= x0) return 1;
  float most = 0, least_w = 1e30f;
  for (const int x : {x0, x1 - 1}) {
    const float i = static_cast<float>(x);
    const float X = base[0] + i * step[0], Y = base[1] + i * step[1], W = base[2] + i * step[2];
    most = std::max(most, std::hypot(shift[0] * W - X * shift[2], shift[1] * W - Y * shift[2]));
    for (const float rho : {inverse_depth[0], inverse_depth[hypotheses - 1]})
      least_w = std::min(least_w, W + rho * shift[2]);
  }
  const float spacing = std::abs(inverse_depth[hypotheses - 1] - inverse_depth[0]) / static_cast<float>(hypotheses - 1);
  const float pixels = spacing * most / (least_w * least_w);
  return pixels * kMostBetween <= kNodeStep ? kMostBetween : std::max(1, static_cast<int>(kNodeStep / pixels));
}

void addRow(const std::uint8_t* reference, int x0, int x1, const RowOfFrame& frame, const float* inverse_depth,
            int hypotheses, int between, const std::uint32_t* packed, int stride, std::uint16_t* cost,
            int cost_stride) {
  static const RowAdder add = fastestRowAdder();
  add(reference, x0, x1, frame, inverse_depth, hypotheses, between, packed, stride, cost, cost_stride);
}

void addRowReference(const std::uint8_t* reference, int x0, int x1, const RowOfFrame& frame, const float* inverse_depth,
                     int hypotheses, const std::uint8_t* image, int stride, std::uint16_t* cost, int cost_stride) {
  const auto &base = frame.base, &step = frame.step, &shift = frame.shift;
  for (int d = 0; d < hypotheses; ++d)
    for (int x = x0; x < x1; ++x) {
      const double w = base[2] + double(x) * step[2] + double(inverse_depth[d]) * shift[2];
      const double u = (base[0] + double(x) * step[0] + double(inverse_depth[d]) * shift[0]) / w;
      const double v = (base[1] + double(x) * step[1] + double(inverse_depth[d]) * shift[1]) / w;
      const int iu = static_cast<int>(std::floor(u)), iv = static_cast<int>(std::floor(v));
      const double fu = u - iu, fv = v - iv;
      const std::uint8_t* p = image + static_cast<std::ptrdiff_t>(iv) * stride + iu;
      const double sample = (1 - fv) * ((1 - fu) * p[0] + fu * p[1]) + fv * ((1 - fu) * p[stride] + fu * p[stride + 1]);
      const int difference = std::min(std::abs(static_cast<int>(std::lround(sample)) - reference[x]), kDifferenceLimit);
      std::uint16_t& out = cost[static_cast<std::ptrdiff_t>(d) * cost_stride + x - x0];
      out = static_cast<std::uint16_t>(out + difference * difference / 4);
    }
}

float squaredDifference(std::uint8_t reference, int x, float rho, const RowOfFrame& frame, const std::uint32_t* packed,
                        int stride) {
  const float i = static_cast<float>(x), w = frame.base[2] + i * frame.step[2] + rho * frame.shift[2];
  const float u = (frame.base[0] + i * frame.step[0] + rho * frame.shift[0]) / w;
  const float v = (frame.base[1] + i * frame.step[1] + rho * frame.shift[1]) / w;
  const int iu = static_cast<int>(u), iv = static_cast<int>(v);  // positive: towards zero is down
  const float fu = u - static_cast<float>(iu), fv = v - static_cast<float>(iv);
  const std::uint32_t p = packed[static_cast<std::ptrdiff_t>(iv) * stride + iu];
  const auto grey = [p](int k) { return static_cast<float>(p >> (8 * k) & 255); };
  const float sample = (1 - fv) * ((1 - fu) * grey(0) + fu * grey(1)) + fv * ((1 - fu) * grey(2) + fu * grey(3));
  const float difference =
      std::min(std::abs(sample - static_cast<float>(reference)), static_cast<float>(kDifferenceLimit));
  return difference * difference;
}

AIR_GROUND_CLONES
void addSquaredDifferences(const std::uint8_t* reference, const std::int32_t* x, const float* rho, int n, int dx,
                           int x0, int x1, const RowOfFrame& frame, const std::uint32_t* packed, int stride,
                           float* __restrict sum) {
  const float X0 = frame.base[0], Y0 = frame.base[1], W0 = frame.base[2], dX = frame.step[0], dY = frame.step[1],
              dW = frame.step[2], sX = frame.shift[0], sY = frame.shift[1], sW = frame.shift[2];
  alignas(64) std::uint32_t pixels[kChunk];
  alignas(64) std::int32_t at[kChunk];
  alignas(64) float across[kChunk], down[kChunk], inside[kChunk], level[kChunk];
  for (int begin = 0; begin < n; begin += kChunk) {
    const int count = std::min(kChunk, n - begin);
    for (int i = 0; i < count; ++i) {
      const int u = x[begin + i] + dx;
      const bool seen = (u >= x0) & (u < x1);
      at[i] = seen ? u : x0;  // which is seen, too
      inside[i] = seen ? 1.F : 0.F;
    }
    for (int i = 0; i < count; ++i) level[i] = static_cast<float>(reference[at[i]]);
    for (int i = 0; i < count; ++i) {
      const float u = static_cast<float>(at[i]), depth = rho[begin + i], scale = 1 / (W0 + u * dW + depth * sW);
      const float px = (X0 + u * dX + depth * sX) * scale, py = (Y0 + u * dY + depth * sY) * scale;
      const std::int32_t iu = static_cast<std::int32_t>(px), iv = static_cast<std::int32_t>(py);
      across[i] = px - static_cast<float>(iu);
      down[i] = py - static_cast<float>(iv);
      pixels[i] = static_cast<std::uint32_t>(iv * stride + iu);
    }
    fetch(packed, count, pixels);
    for (int i = 0; i < count; ++i) {
      const auto p = static_cast<std::int32_t>(pixels[i]);
      const float a = static_cast<float>(p & 255), b = static_cast<float>(p >> 8 & 255),
                  c = static_cast<float>(p >> 16 & 255), d = static_cast<float>(p >> 24 & 255);
      const float upper = a + across[i] * (b - a), lower = c + across[i] * (d - c);
      const float sample = upper + down[i] * (lower - upper);
      const float difference = sample - level[i], size = difference < 0 ? -difference : difference;
      const float cut = size < static_cast<float>(kDifferenceLimit) ? size : static_cast<float>(kDifferenceLimit);
      sum[begin + i] += inside[i] * cut * cut;
    }
  }
}

void packNeighborhoods(const std::uint8_t* image, int width, int height, std::uint32_t* packed) {
  for (int y = 0; y < height; ++y) {
    const std::uint8_t* top = image + static_cast<std::ptrdiff_t>(y) * width;
    const std::uint8_t* bottom = y + 1 < height ? top + width : top;
    std::uint32_t* out = packed + static_cast<std::ptrdiff_t>(y) * width;
    const auto pack = [&](int x, int right) {
      out[x] =
          top[x] | std::uint32_t(top[right]) << 8 | std::uint32_t(bottom[x]) << 16 | std::uint32_t(bottom[right]) << 24;
    };
    for (int x = 0; x + 1 < width; ++x) pack(x, x + 1);
    pack(width - 1, width - 1);
  }
}

AIR_GROUND_CLONES
void slideSum(std::uint32_t* sum, const std::uint16_t* enter, const std::uint16_t* leave, int count) {
  if (enter && leave) {
    for (int i = 0; i < count; ++i) sum[i] += static_cast<std::uint32_t>(enter[i]) - leave[i];
  } else if (enter) {
    for (int i = 0; i < count; ++i) sum[i] += enter[i];
  } else if (leave) {
    for (int i = 0; i < count; ++i) sum[i] -= leave[i];
  }
}

AIR_GROUND_CLONES
void boxRows(const std::uint32_t* sum, int rows, int stride, int n, int radius, std::uint32_t* out) {
  for (int r = 0; r < rows; ++r) {
    const std::uint32_t* in = sum + static_cast<std::ptrdiff_t>(r) * stride;
    std::uint32_t* __restrict to = out + static_cast<std::ptrdiff_t>(r) * stride;
    if (radius == 2) {  // the default, in one pass
      for (int x = 0; x < n; ++x) to[x] = in[x] + in[x + 1] + in[x + 2] + in[x + 3] + in[x + 4];
      continue;
    }
    for (int x = 0; x < n; ++x) to[x] = in[x];
    for (int k = 1; k <= 2 * radius; ++k)
      for (int x = 0; x < n; ++x) to[x] += in[x + k];
  }
}

AIR_GROUND_CLONES
void winnerTakesAll(const std::uint32_t* __restrict cost, int hypotheses, int stride, int n, int exclusion,
                    std::uint32_t* __restrict best, std::int32_t* __restrict index, std::uint32_t* __restrict second) {
  for (int x = 0; x < n; ++x) {
    best[x] = cost[x];
    index[x] = 0;
    second[x] = 0x7fffffffu;
  }
  for (int d = 1; d < hypotheses; ++d) {
    const std::uint32_t* c = cost + static_cast<std::ptrdiff_t>(d) * stride;
    for (int x = 0; x < n; ++x) {
      const bool smaller = c[x] < best[x];
      best[x] = smaller ? c[x] : best[x];
      index[x] = smaller ? d : index[x];
    }
  }
  for (int d = 0; d < hypotheses; ++d) {
    const std::uint32_t* c = cost + static_cast<std::ptrdiff_t>(d) * stride;
    for (int x = 0; x < n; ++x) {
      const bool outside = std::abs(d - index[x]) > exclusion;
      const std::uint32_t candidate = outside ? c[x] : 0x7fffffffu;
      second[x] = candidate < second[x] ? candidate : second[x];
    }
  }
}

}  // namespace dense_fusion::kernels
