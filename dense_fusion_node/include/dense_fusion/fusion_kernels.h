// Inner loops of the depth map fusion on plain arrays; vectorised per CPU generation at run time (clones.h).
#pragma once

#include <cstdint>

namespace dense_fusion::kernels {

/// One row of voxels against one depth map. The camera-frame position of voxel x is start + x * step [m].
/// Writes the bin of the vote, or 255 for none: outside the view, no depth, f below `lowest`. Camera: fx fy cx cy [px].
void voteRow(const float start[3], const float step[3], int nx, const float camera[4], const float* depth, int width,
             int height, float inverse_truncation, float lowest, std::uint8_t* bin);

/// counts[k * stride + x] += (bin[x] == k), saturating, for x in [0, n).
void countRow(const std::uint8_t* bin, int n, std::uint8_t* counts, int stride);

/// Dual step of n voxels of a row: p <- q / max(1, |q|), q = p + sigma grad(ubar), forward differences. ubar_y, ubar_z
/// are the next rows in y and z; at the border pass the row itself (Neumann: the difference is zero). `at_border`: the
/// last voxel is the last of its row; else ubar[n] is read. True when any value of p has changed.
bool dualRow(const float* ubar, const float* ubar_y, const float* ubar_z, float* px, float* py, float* pz, int n,
             bool at_border, float sigma);

/// Primal step of n voxels of a row: u+ = argmin of the data term around u + tau div p, then ubar = 2 u+ - u.
/// py_before, pz_before: rows one step before in y and z; at the border pass zeros. `at_border`: the first voxel is the
/// first of its row; else px[-1] is read. Counts of the bins lie `stride` apart; null: no votes. True when u or ubar
/// has changed.
bool primalRow(float* u, float* ubar, const float* px, const float* py, const float* py_before, const float* pz,
               const float* pz_before, const std::uint8_t* counts, int stride, int n, bool at_border, float tau,
               float lambda);
bool primalRow(float* u, float* ubar, const float* px, const float* py, const float* py_before, const float* pz,
               const float* pz_before, const std::uint16_t* counts, int stride, int n, bool at_border, float tau,
               float lambda);

/// support[x] = votes in all bins but the first and the last, at most 255. Counts of the bins lie `stride` apart.
void supportRow(const std::uint8_t* counts, int stride, int n, std::uint8_t* support);

/// changes[x]: bit k is set where u[x] > 0 and the next value along axis k is not, or the other way round. next_y,
/// next_z: the next rows; at the border pass the row itself. u[n] is not read: the last voxel has no next one in x.
void signChanges(const float* u, const float* next_y, const float* next_z, int n, std::uint8_t* changes);

/// least[x] = min(least[x], u[x])
void lowerTo(const float* u, int n, float* least);

}  // namespace dense_fusion::kernels
