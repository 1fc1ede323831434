// Inner loops of the plane sweep on plain arrays; vectorised per CPU generation at run time (clones.h).
#pragma once

#include <cstdint>

namespace dense_fusion::kernels {

/// Truncated squared difference of 8-bit values, divided by 4 so that 64 frames fit in 16 bits.
constexpr int kDifferenceLimit = 63;

/// A row of the reference as a frame sees it: pixel x at inverse depth rho [1/m] lies at (X / W, Y / W) [px],
/// (X, Y, W) = base + x * step + rho * shift.
struct RowOfFrame {
  float base[3], step[3], shift[3];
};

/// Hypotheses from one image sample to the next such that those of any pixel in [x0, x1) lie half a pixel apart at
/// most. inverse_depth must be evenly spaced.
int hypothesesBetween(int x0, int x1, const RowOfFrame& frame, const float* inverse_depth, int hypotheses);

/// Entries from one hypothesis to the next that `pixels` pixels of a row need: costs are added by whole vectors, of
/// which those beyond the last pixel stay as they are.
constexpr int costStride(int pixels) { return (pixels + 15) / 16 * 16 + 16; }

/// Adds one frame to one row of the cost volume: for every hypothesis d and every x in [x0, x1)
///   cost[d * cost_stride + x - x0] += min(|sample - reference[x]|, 63)^2 / 4
/// with the sample where the frame sees the pixel. `packed`: the 2x2 neighbourhood of each of the frame's pixels in 32
/// bits (see packNeighborhoods), `stride` entries a row. All samples must lie at least half a pixel inside the image.
/// Of hypotheses nearer than `between` to the last one that was sampled, differences are linear.
void addRow(const std::uint8_t* reference, int x0, int x1, const RowOfFrame& frame, const float* inverse_depth,
            int hypotheses, int between, const std::uint32_t* packed, int stride, std::uint16_t* cost, int cost_stride);

/// The same in plain floating point; differs from addRow by the rounding of its sample positions and weights.
void addRowReference(const std::uint8_t* reference, int x0, int x1, const RowOfFrame& frame, const float* inverse_depth,
                     int hypotheses, const std::uint8_t* image, int stride, std::uint16_t* cost, int cost_stride);

/// min(|sample - reference|, 63)^2 of pixel x alone, at inverse depth rho.
float squaredDifference(std::uint8_t reference, int x, float rho, const RowOfFrame& frame, const std::uint32_t* packed,
                        int stride);

/// sum[i] += squaredDifference of pixel x[i] + dx at inverse depth rho[i], for those of the `n` whose pixel lies in
/// [x0, x1). `reference`: its row.
void addSquaredDifferences(const std::uint8_t* reference, const std::int32_t* x, const float* rho, int n, int dx,
                           int x0, int x1, const RowOfFrame& frame, const std::uint32_t* packed, int stride,
                           float* sum);

/// packed[y * width + x] = image(x, y) | image(x+1, y) << 8 | image(x, y+1) << 16 | image(x+1, y+1) << 24, borders
/// replicated.
void packNeighborhoods(const std::uint8_t* image, int width, int height, std::uint32_t* packed);

/// sum[i] += enter[i] - leave[i]; a null pointer stands for zeros.
void slideSum(std::uint32_t* sum, const std::uint16_t* enter, const std::uint16_t* leave, int count);

/// out[x] = the sum of the 2 * radius + 1 entries of `sum` from x on, for x in [0, n) in each of `rows` rows.
void boxRows(const std::uint32_t* sum, int rows, int stride, int n, int radius, std::uint32_t* out);

/// For each x in [0, n): smallest cost over the hypotheses, its index, and the smallest cost further than `exclusion`
/// from it.
void winnerTakesAll(const std::uint32_t* cost, int hypotheses, int stride, int n, int exclusion, std::uint32_t* best,
                    std::int32_t* index, std::uint32_t* second);

}  // namespace dense_fusion::kernels
