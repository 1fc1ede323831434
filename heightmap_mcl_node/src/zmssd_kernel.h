// Hot loops on plain arrays, compiled for several instruction sets; see zmssd_kernel.cpp.
#pragma once

namespace heightmap_mcl::kernel {

struct GroundView {
  const float* heights;  // row-major, NaN for holes, bordered by one cell of holes
  int width, height;     // with the border
};

struct Sums {
  double n, sum, squares;  // of d = aerial - ground over the cells defined in both
};

/// Cell coordinates of aerial cell i: column = c*x - s*y + tx, row = s*x + c*y + ty, in cells of the bordered grid.
Sums differences(const float* x, const float* y, const float* h, int n, float c, float s, float tx, float ty,
                 const GroundView& ground);

/// out_k += conj-products of one heading's spectra; interleaved complex arrays of n elements:
/// n_out = conj(a0) g0, s1_out = conj(a1) g0 - conj(a0) g1, s2_out = conj(a2) g0 + conj(a0) g2 - 2 conj(a1) g1.
void correlate(const float* a0, const float* a1, const float* a2, const float* g0, const float* g1, const float* g2, int n,
               float* n_out, float* s1_out, float* s2_out);

/// Equation 2 for a row of offsets from the inverse transforms (each still to be multiplied by `scale`).
/// cost[i] = infinity where the overlap is below min_cells. smaller_cells: defined cells of the smaller map.
void costRow(const float* n_in, const float* s1_in, const float* s2_in, int n, float scale, float min_cells,
             float smaller_cells, float unknown_cost, float* cost);

}  // namespace heightmap_mcl::kernel
