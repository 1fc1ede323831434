#include "dense_fusion/cost_kernels.h"

#include <algorithm>
#include <cmath>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

// Plain arrays only: no Eigen type may cross into these functions, whose alignment rules differ per clone.
#define AIR_GROUND_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))

namespace dense_fusion::kernels {
namespace {
constexpr int kChunk = 256;         // pixels worked on at once, so that their operands stay in the first-level cache
constexpr int kFractionBits = 6;    // sample positions are rounded to 1/64 px
constexpr int kGreyBits = 7;        // fraction of a difference of grey levels: 255 << 7 fits in 16 bits
constexpr float kNodeStep = 0.25f;  // images are sampled this densely along a pixel's line of samples, at least [px]
constexpr int kMostBetween = 16;    // hypotheses from one sample to the next; rounding of their steps adds up

// Hypotheses from one image sample to the next, so that samples of any pixel of the row lie within kNodeStep.
// Along rho a sample moves by (shift_xy W - XY shift_w) / (W + rho shift_w)^2, whose numerator does not depend on rho.
int hypothesesBetween(int x0, int x1, const float* base, const float* step, const float* shift,
                      const float* inverse_depth, int hypotheses) {
  if (hypotheses < 2) return 1;
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

constexpr int kOne = 1 << kFractionBits;
constexpr int kSampleShift = 2 * kFractionBits - kGreyBits;

/// Pixels of a row, and where they lie in the frame.
struct Pixels {
  int n = 0;
  const float *X = nullptr, *Y = nullptr, *W = nullptr;
  const std::int16_t* reference = nullptr;  ///< grey levels << kGreyBits
  const std::uint32_t* packed = nullptr;    ///< the frame
  int stride = 0;
};

// (sample - reference) << kGreyBits of the pixels from `first` on at one hypothesis, whose shifts are s.
void samplePlain(const Pixels& p, int first, float sx, float sy, float sw, std::int16_t* __restrict out) {
  for (int i = first; i < p.n; ++i) {
    const float scale = kOne / (p.W[i] + sw);
    const std::int32_t u = static_cast<std::int32_t>((p.X[i] + sx) * scale + 0.5f);
    const std::int32_t v = static_cast<std::int32_t>((p.Y[i] + sy) * scale + 0.5f);
    const std::int32_t fu = u & (kOne - 1), fv = v & (kOne - 1);
    const std::uint32_t q = p.packed[(v >> kFractionBits) * p.stride + (u >> kFractionBits)];
    const std::int32_t a = q & 255, b = (q >> 8) & 255, c = (q >> 16) & 255, e = q >> 24;
    const std::int32_t top = a * kOne + fu * (b - a);
    const std::int32_t bottom = c * kOne + fu * (e - c);
    const std::int32_t sample = (top * kOne + fv * (bottom - top)) >> kSampleShift;
    out[i] = static_cast<std::int16_t>(sample - p.reference[i]);
  }
}

#if defined(__x86_64__)
// The same, by gathers, and with both linear interpolations as products of pairs: bytes a, b by (64 - fu, fu), then
// 16-bit top, bottom by (64 - fv, fv). The compiler finds neither.
__attribute__((target("avx2"))) inline __m256i sampleEight(const Pixels& p, int i, __m256 sx, __m256 sy, __m256 sw) {
  const __m256 half = _mm256_set1_ps(0.5f);
  const __m256i one = _mm256_set1_epi32(kOne), fraction = _mm256_set1_epi32(kOne - 1);
  const __m256 scale = _mm256_div_ps(_mm256_set1_ps(kOne), _mm256_add_ps(_mm256_loadu_ps(p.W + i), sw));
  const auto position = [&](const float* at, __m256 shift) __attribute__((target("avx2"))) {
    return _mm256_cvttps_epi32(
        _mm256_add_ps(_mm256_mul_ps(_mm256_add_ps(_mm256_loadu_ps(at + i), shift), scale), half));
  };
  const __m256i u = position(p.X, sx), v = position(p.Y, sy);
  const __m256i index =
      _mm256_add_epi32(_mm256_mullo_epi32(_mm256_srai_epi32(v, kFractionBits), _mm256_set1_epi32(p.stride)),
                       _mm256_srai_epi32(u, kFractionBits));
  const __m256i q = _mm256_i32gather_epi32(reinterpret_cast<const int*>(p.packed), index, 4);
  const __m256i fu = _mm256_and_si256(u, fraction), fv = _mm256_and_si256(v, fraction);
  const __m256i pair = _mm256_add_epi32(_mm256_sub_epi32(one, fu), _mm256_slli_epi32(fu, 8));
  const __m256i across = _mm256_or_si256(pair, _mm256_slli_epi32(pair, 16));
  const __m256i down = _mm256_or_si256(_mm256_sub_epi32(one, fv), _mm256_slli_epi32(fv, 16));
  return _mm256_srai_epi32(_mm256_madd_epi16(_mm256_maddubs_epi16(q, across), down), kSampleShift);
}

__attribute__((target("avx2"))) void sampleAvx2(const Pixels& p, int first, float sx, float sy, float sw,
                                                std::int16_t* __restrict out) {
  const __m256 x = _mm256_set1_ps(sx), y = _mm256_set1_ps(sy), w = _mm256_set1_ps(sw);
  int i = first;
  for (; i + 16 <= p.n; i += 16) {
    const __m256i samples =
        _mm256_permute4x64_epi64(_mm256_packs_epi32(sampleEight(p, i, x, y, w), sampleEight(p, i + 8, x, y, w)), 0xd8);
    const __m256i reference = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p.reference + i));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + i), _mm256_sub_epi16(samples, reference));
  }
  samplePlain(p, i, sx, sy, sw, out);
}
#endif

using Sampler = void (*)(const Pixels&, int, float, float, float, std::int16_t*);

Sampler fastestSampler() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) return sampleAvx2;
#endif
  return samplePlain;
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
}  // namespace

AIR_GROUND_CLONES
void addRow(const std::uint8_t* reference, int x0, int x1, int width, const float* base, const float* step,
            const float* shift, const float* inverse_depth, int hypotheses, const std::uint32_t* packed, int stride,
            std::uint16_t* cost) {
  alignas(64) float X[kChunk], Y[kChunk], W[kChunk];
  alignas(64) std::int16_t target[kChunk], delta[kChunk], samples[2][kChunk] = {};
  static const Sampler sample = fastestSampler();
  const int between = hypothesesBetween(x0, x1, base, step, shift, inverse_depth, hypotheses);
  for (int begin = x0; begin < x1; begin += kChunk) {
    const int n = std::min(kChunk, x1 - begin);
    for (int i = 0; i < n; ++i) {
      const float x = static_cast<float>(begin + i);
      X[i] = base[0] + x * step[0];
      Y[i] = base[1] + x * step[1];
      W[i] = base[2] + x * step[2];
      target[i] = static_cast<std::int16_t>(reference[begin + i] << kGreyBits);
    }
    const Pixels pixels{n, X, Y, W, target, packed, stride};
    const auto sampleAt = [&](int d, std::int16_t* out) {
      const float rho = inverse_depth[d];
      sample(pixels, 0, rho * shift[0], rho * shift[1], rho * shift[2], out);
    };
    std::int16_t *here = samples[0], *next = samples[1];
    sampleAt(0, here);
    for (int d = 0; d < hypotheses;) {
      const int k = std::max(1, std::min(between, hypotheses - 1 - d));
      if (d + k < hypotheses) sampleAt(d + k, next);
      // (x * part + 2^14) >> 15 is one instruction (pmulhrsw); with k = 1 only the first, without the delta, is used.
      const std::int16_t part = static_cast<std::int16_t>(32768 / std::max(2, k));
      for (int i = 0; i < n; ++i) {
        const std::int16_t change = static_cast<std::int16_t>(next[i] - here[i]);
        delta[i] = static_cast<std::int16_t>((change * part + 16384) >> 15);
      }
      for (int j = 0; j < k; ++j, ++d)
        addSquares(n, here, delta, static_cast<std::int16_t>(j), cost + static_cast<std::ptrdiff_t>(d) * width + begin);
      std::swap(here, next);
    }
  }
}

void addRowReference(const std::uint8_t* reference, int x0, int x1, int width, const float* base, const float* step,
                     const float* shift, const float* inverse_depth, int hypotheses, const std::uint8_t* image,
                     int stride, std::uint16_t* cost) {
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
      std::uint16_t& out = cost[static_cast<std::ptrdiff_t>(d) * width + x];
      out = static_cast<std::uint16_t>(out + difference * difference / 4);
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
void boxRows(const std::uint32_t* sum, int rows, int width, int radius, std::uint32_t* out) {
  for (int r = 0; r < rows; ++r) {
    const std::uint32_t* in = sum + static_cast<std::ptrdiff_t>(r) * width;
    std::uint32_t* to = out + static_cast<std::ptrdiff_t>(r) * width;
    const int inner_end = std::max(radius, width - radius);
    for (int x = radius; x < inner_end; ++x) to[x] = in[x];
    for (int k = 1; k <= radius; ++k)
      for (int x = radius; x < inner_end; ++x) to[x] += in[x - k] + in[x + k];
    for (int x = 0; x < width; ++x) {
      if (x == radius && inner_end > radius) x = inner_end;
      if (x >= width) break;
      std::uint32_t s = 0;
      for (int k = std::max(0, x - radius); k <= std::min(width - 1, x + radius); ++k) s += in[k];
      to[x] = s;
    }
  }
}

AIR_GROUND_CLONES
void winnerTakesAll(const std::uint32_t* cost, int hypotheses, int width, int exclusion, std::uint32_t* best,
                    std::int32_t* index, std::uint32_t* second) {
  for (int x = 0; x < width; ++x) {
    best[x] = cost[x];
    index[x] = 0;
    second[x] = 0x7fffffffu;
  }
  for (int d = 1; d < hypotheses; ++d) {
    const std::uint32_t* c = cost + static_cast<std::ptrdiff_t>(d) * width;
    for (int x = 0; x < width; ++x) {
      const bool smaller = c[x] < best[x];
      best[x] = smaller ? c[x] : best[x];
      index[x] = smaller ? d : index[x];
    }
  }
  for (int d = 0; d < hypotheses; ++d) {
    const std::uint32_t* c = cost + static_cast<std::ptrdiff_t>(d) * width;
    for (int x = 0; x < width; ++x) {
      const bool outside = std::abs(d - index[x]) > exclusion;
      const std::uint32_t candidate = outside ? c[x] : 0x7fffffffu;
      second[x] = candidate < second[x] ? candidate : second[x];
    }
  }
}

}  // namespace dense_fusion::kernels
