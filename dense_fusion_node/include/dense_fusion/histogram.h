// Histograms of distance votes, one a voxel (paper A, section V; Zach 2008).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "dense_fusion/field.h"

namespace dense_fusion {

constexpr int kBins = 8;  ///< bins of a voxel's histogram

/// Centre c_j of a bin: evenly spaced over [-1, 1], j = 0..7.
constexpr float binCenter(int j) { return -1.f + 2.f * j / (kBins - 1); }

/// Counts n(v, j) of equation 1. Memory order [z][y][bin][x], so that the rows of a bin vectorise.
/// `Count` is uint8_t for votes and uint16_t for the sums of coarser levels.
template <typename Count>
struct Histograms {
  int nx = 0, ny = 0, nz = 0;
  Field<Count> counts;

  void resize(int x, int y, int z) {
    nx = x;
    ny = y;
    nz = z;
    counts.assign(static_cast<std::size_t>(x) * y * z * kBins, 0);
  }
  Count* row(int y, int z) { return &counts[(static_cast<std::size_t>(z) * ny + y) * kBins * nx]; }
  const Count* row(int y, int z) const { return &counts[(static_cast<std::size_t>(z) * ny + y) * kBins * nx]; }
  Count at(int x, int y, int z, int bin) const { return row(y, z)[static_cast<std::size_t>(bin) * nx + x]; }
};

/// Sums of 2x2x2 voxels; odd sizes are rounded up and the missing voxels count nothing.
Histograms<std::uint16_t> halve(const Histograms<std::uint8_t>& fine, int threads);
Histograms<std::uint16_t> halve(const Histograms<std::uint16_t>& fine, int threads);

}  // namespace dense_fusion
