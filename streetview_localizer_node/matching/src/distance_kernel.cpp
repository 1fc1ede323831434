#include "distance_kernel.h"

#include <algorithm>
#include <climits>

#include "air_ground_common/clones.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace streetview_localizer {
namespace {

constexpr int kGroups = kDescriptorSize / 4;
constexpr std::int32_t kPadding = 1 << 29;

// |q - p|^2 = |q|^2 + |p|^2 - 2 q.p for 4 queries and one block of 16. `norms`: of the queries.
void blockPlain(const std::uint8_t* const* query, const std::int32_t* norms, const std::uint8_t* block,
                const std::int32_t* block_norm, std::int32_t* out, std::size_t out_stride) {
  for (int q = 0; q < 4; ++q) {
    std::int32_t dot[kLanes] = {};
    for (int g = 0; g < kGroups; ++g)
      for (int lane = 0; lane < kLanes; ++lane)
        for (int e = 0; e < 4; ++e) dot[lane] += query[q][4 * g + e] * block[(g * kLanes + lane) * 4 + e];
    for (int lane = 0; lane < kLanes; ++lane) out[q * out_stride + lane] = norms[q] + block_norm[lane] - 2 * dot[lane];
  }
}

#if defined(__x86_64__)

// Eight lanes at a time: the bytes widened to 16 bits, two products a 32-bit sum.
__attribute__((target("avx2"))) void blockAvx2(const std::uint8_t* const* query, const std::int32_t* norms,
                                               const std::uint8_t* block, const std::int32_t* block_norm,
                                               std::int32_t* out, std::size_t out_stride) {
  for (int half = 0; half < 2; ++half) {
    __m256i low[4], high[4];  // lanes 0-3 and 4-7, two partial sums each
    for (int q = 0; q < 4; ++q) low[q] = high[q] = _mm256_setzero_si256();
    for (int g = 0; g < kGroups; ++g) {
      const auto* bytes = reinterpret_cast<const __m128i*>(block + g * kLanes * 4 + half * 32);
      const __m256i a = _mm256_cvtepu8_epi16(_mm_loadu_si128(bytes));
      const __m256i b = _mm256_cvtepu8_epi16(_mm_loadu_si128(bytes + 1));
      for (int q = 0; q < 4; ++q) {
        const __m128i four = _mm_cvtepu8_epi16(_mm_loadu_si32(query[q] + 4 * g));
        const __m256i broadcast = _mm256_broadcastq_epi64(four);
        low[q] = _mm256_add_epi32(low[q], _mm256_madd_epi16(a, broadcast));
        high[q] = _mm256_add_epi32(high[q], _mm256_madd_epi16(b, broadcast));
      }
    }
    for (int q = 0; q < 4; ++q) {
      // hadd interleaves 128-bit halves: lanes 0 1 4 5 2 3 6 7.
      const __m256i dot = _mm256_permute4x64_epi64(_mm256_hadd_epi32(low[q], high[q]), 0xD8);
      const __m256i norm = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(block_norm + half * 8));
      const __m256i d =
          _mm256_sub_epi32(_mm256_add_epi32(norm, _mm256_set1_epi32(norms[q])), _mm256_slli_epi32(dot, 1));
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + q * out_stride + half * 8), d);
    }
  }
}

// The instruction multiplies unsigned by signed bytes: the query's are taken less 128, which `sum` of the block makes
// up for.
__attribute__((target("avx512f,avx512bw,avx512vnni"))) void rowVnni(const std::uint8_t* const* query,
                                                                    const std::int32_t* norms,
                                                                    const PackedDescriptors& packed, std::int32_t* out,
                                                                    std::size_t out_stride) {
  std::int32_t shifted[4][kGroups];
  for (int q = 0; q < 4; ++q)
    for (int g = 0; g < kGroups; ++g) {
      std::uint32_t four = 0;
      for (int e = 3; e >= 0; --e) four = four << 8 | (query[q][4 * g + e] ^ 0x80u);
      shifted[q][g] = static_cast<std::int32_t>(four);
    }
  for (int b = 0; b < packed.blocks; b += 2) {
    const bool two = b + 1 < packed.blocks;
    const std::uint8_t* first = packed.bytes.data() + static_cast<std::size_t>(b) * kGroups * 64;
    const std::uint8_t* second = two ? first + kGroups * 64 : first;
    __m512i dot[4][2];
    for (int q = 0; q < 4; ++q) dot[q][0] = dot[q][1] = _mm512_setzero_si512();
    for (int g = 0; g < kGroups; ++g) {
      const __m512i a0 = _mm512_loadu_si512(first + g * 64), a1 = _mm512_loadu_si512(second + g * 64);
      for (int q = 0; q < 4; ++q) {
        const __m512i broadcast = _mm512_set1_epi32(shifted[q][g]);
        dot[q][0] = _mm512_dpbusd_epi32(dot[q][0], a0, broadcast);
        dot[q][1] = _mm512_dpbusd_epi32(dot[q][1], a1, broadcast);
      }
    }
    for (int i = 0; i < (two ? 2 : 1); ++i) {
      const __m512i norm = _mm512_loadu_si512(packed.squared_norm.data() + (b + i) * kLanes);
      const __m512i shift = _mm512_loadu_si512(packed.shift.data() + (b + i) * kLanes);
      for (int q = 0; q < 4; ++q) {
        const __m512i constant = _mm512_add_epi32(_mm512_sub_epi32(norm, shift), _mm512_set1_epi32(norms[q]));
        _mm512_storeu_si512(out + q * out_stride + (b + i) * kLanes,
                            _mm512_sub_epi32(constant, _mm512_add_epi32(dot[q][i], dot[q][i])));
      }
    }
  }
}

#endif

}  // namespace

bool isSupported(Simd simd) {
  if (simd == Simd::kNone) return true;
#if defined(__x86_64__)
  if (simd == Simd::kAvx2) return __builtin_cpu_supports("avx2");
  return __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vnni");
#else
  return false;
#endif
}

Simd bestSimd() {
  static const Simd best = isSupported(Simd::kAvx512Vnni) ? Simd::kAvx512Vnni
                           : isSupported(Simd::kAvx2)     ? Simd::kAvx2
                                                          : Simd::kNone;
  return best;
}

PackedDescriptors packDescriptors(const std::uint8_t* rows, int count, std::size_t stride) {
  PackedDescriptors packed;
  packed.count = count;
  packed.blocks = (count + kLanes - 1) / kLanes;
  const std::size_t padded = static_cast<std::size_t>(packed.blocks) * kLanes;
  packed.bytes.assign(padded * kDescriptorSize, 0);
  packed.squared_norm.assign(padded, kPadding);
  packed.shift.assign(padded, 0);
  for (int j = 0; j < count; ++j) {
    const std::uint8_t* row = rows + j * stride;
    std::uint8_t* block = packed.bytes.data() + static_cast<std::size_t>(j / kLanes) * kGroups * 64;
    std::int32_t norm = 0, sum = 0;
    for (int e = 0; e < kDescriptorSize; ++e) {
      block[(e / 4 * kLanes + j % kLanes) * 4 + e % 4] = row[e];
      norm += row[e] * row[e];
      sum += row[e];
    }
    packed.squared_norm[j] = norm;
    packed.shift[j] = 256 * sum;
  }
  return packed;
}

void distancesOfFour(const std::uint8_t* query, std::size_t stride, const PackedDescriptors& packed, std::int32_t* out,
                     Simd simd) {
  const std::uint8_t* rows[4];
  std::int32_t norms[4] = {};
  for (int q = 0; q < 4; ++q) {
    rows[q] = query + q * stride;
    for (int e = 0; e < kDescriptorSize; ++e) norms[q] += rows[q][e] * rows[q][e];
  }
  const std::size_t out_stride = static_cast<std::size_t>(packed.blocks) * kLanes;
#if defined(__x86_64__)
  if (simd == Simd::kAvx512Vnni) {
    rowVnni(rows, norms, packed, out, out_stride);
    return;
  }
#endif
  for (int b = 0; b < packed.blocks; ++b) {
    const std::uint8_t* block = packed.bytes.data() + static_cast<std::size_t>(b) * kGroups * 64;
    const std::int32_t* block_norm = packed.squared_norm.data() + b * kLanes;
#if defined(__x86_64__)
    if (simd == Simd::kAvx2) {
      blockAvx2(rows, norms, block, block_norm, out + b * kLanes, out_stride);
      continue;
    }
#endif
    blockPlain(rows, norms, block, block_norm, out + b * kLanes, out_stride);
  }
}

AIR_GROUND_CLONES std::int32_t squaredDistance(const std::uint8_t* a, const std::uint8_t* b) {
  std::int32_t sum = 0;
  for (int e = 0; e < kDescriptorSize; ++e) {
    const std::int16_t d = static_cast<std::int16_t>(a[e] - b[e]);
    sum += d * d;
  }
  return sum;
}

AIR_GROUND_CLONES void minimumOf(const std::int32_t* values, int count, std::int32_t* minimum, int* index) {
  std::int32_t least = INT32_MAX;
  for (int j = 0; j < count; ++j) least = values[j] < least ? values[j] : least;
  *minimum = least;
  *index = static_cast<int>(std::find(values, values + count, least) - values);
}

AIR_GROUND_CLONES std::int32_t minimumElsewhere(const std::int32_t* values, const float* x, const float* y, int count,
                                                float x0, float y0, float r2, std::int32_t enough) {
  constexpr int kBlock = 256;
  std::int32_t least = INT32_MAX;
  for (int begin = 0; begin < count && least >= enough; begin += kBlock) {
    const int end = begin + kBlock < count ? begin + kBlock : count;
    for (int j = begin; j < end; ++j) {
      const float dx = x[j] - x0, dy = y[j] - y0;
      const std::int32_t value = dx * dx + dy * dy > r2 ? values[j] : INT32_MAX;
      least = value < least ? value : least;
    }
  }
  return least;
}

AIR_GROUND_CLONES void lowerColumns(const std::int32_t* values, int count, std::int32_t id, std::int32_t* best,
                                    std::int32_t* owner) {
  for (int j = 0; j < count; ++j) {
    const bool lower = values[j] < best[j];
    owner[j] = lower ? id : owner[j];
    best[j] = lower ? values[j] : best[j];
  }
}

}  // namespace streetview_localizer
