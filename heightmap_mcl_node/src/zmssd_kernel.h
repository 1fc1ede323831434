// Hot loops on plain arrays, compiled for several instruction sets; see zmssd_kernel.cpp.
#pragma once

#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl::kernel {

struct GroundView {
  const float* heights;  // row-major, NaN for holes, bordered by one cell of holes
  int width, height;     // with the border
};

/// Cell coordinates of aerial cell i: column = c*x - s*y + tx, row = s*x + c*y + ty, in cells of the bordered grid.
OverlapSums overlapSums(const float* x, const float* y, const float* h, int n, float c, float s, float tx, float ty,
                        const GroundView& ground);

/// Products of one heading's spectra (mask, heights, squared heights of either map), interleaved complex arrays of n
/// elements: the spectra of the sums over the overlap of 1, a - g, (a - g)^2, a, a^2, g^2, in the order of OverlapSums.
void correlate(const float* const air[3], const float* const ground[3], int n, float* const out[6]);

/// Scores for a row of n offsets from the inverse transforms of correlate's products (each still to be multiplied by
/// `scale`). score[i] = infinity where the overlap is below min_overlap. cells: defined cells of the smaller map.
void scoreRow(const float* const sums[6], int n, float scale, float cells, const CostSettings& settings, float* score);

}  // namespace heightmap_mcl::kernel
