// Inner loops of the plane sweep on plain arrays; vectorised per CPU generation at run time (target_clones).
#pragma once

#include <cstdint>

namespace dense_fusion::kernels {

/// Truncated squared difference of 8-bit values, divided by 4 so that 64 frames fit in 16 bits.
constexpr int kDifferenceLimit = 63;

/// Adds one frame to one row of the cost volume: for every hypothesis d and every x in [x0, x1)
///   (X, Y, W) = base + x * step + inverse_depth[d] * shift,  sample = image(X / W, Y / W),
///   cost[d * width + x] += min(|sample - reference[x]|, 63)^2 / 4.
/// `packed`: the 2x2 neighbourhood of each pixel in 32 bits (see packNeighborhoods), `stride` entries a row.
/// All samples must lie at least half a pixel inside the image. inverse_depth must be evenly spaced: samples lie a
/// quarter of a pixel apart at most, and where hypotheses are nearer than that, differences between them are linear.
void addRow(const std::uint8_t* reference, int x0, int x1, int width, const float base[3], const float step[3],
            const float shift[3], const float* inverse_depth, int hypotheses, const std::uint32_t* packed, int stride,
            std::uint16_t* cost);

/// The same in plain floating point; differs from addRow by the rounding of its sample positions and weights.
void addRowReference(const std::uint8_t* reference, int x0, int x1, int width, const float base[3], const float step[3],
                     const float shift[3], const float* inverse_depth, int hypotheses, const std::uint8_t* image,
                     int stride, std::uint16_t* cost);

/// packed[y * width + x] = image(x, y) | image(x+1, y) << 8 | image(x, y+1) << 16 | image(x+1, y+1) << 24, borders
/// replicated.
void packNeighborhoods(const std::uint8_t* image, int width, int height, std::uint32_t* packed);

/// sum[i] += enter[i] - leave[i]; a null pointer stands for zeros.
void slideSum(std::uint32_t* sum, const std::uint16_t* enter, const std::uint16_t* leave, int count);

/// Horizontal window of 2 * radius + 1 over each of `rows` rows of `width` sums, clipped at the row's ends.
void boxRows(const std::uint32_t* sum, int rows, int width, int radius, std::uint32_t* out);

/// For each x: smallest cost over the hypotheses, its index, and the smallest cost further than `exclusion` from it.
void winnerTakesAll(const std::uint32_t* cost, int hypotheses, int width, int exclusion, std::uint32_t* best,
                    std::int32_t* index, std::uint32_t* second);

}  // namespace dense_fusion::kernels
