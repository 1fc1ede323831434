// Minimisation of equation 1 of paper A (section V; Zach 2008): total variation plus an L1 distance to the votes.
#pragma once

#include <vector>

#include "dense_fusion/histogram.h"

namespace dense_fusion {

struct TvL1Settings {
  double lambda = 0.26;     ///< weight of the data term against the surface's area (paper: 0.26)
  int iterations = 8;       ///< at full resolution (paper: 8); the limit when relative_gap is positive
  double relative_gap = 0;  ///< stop when (primal - dual) / primal falls below it; 0: run `iterations`. Checked every 8
  int coarse_levels = 2;    ///< halvings of the grid whose solution starts the next finer one; 0: cold start
  int coarse_iterations = 60;  ///< at the coarsest level; half as many at each finer one
  int threads = 2;
};

/// phi of equation 1 in [-1, 1], in VoxelGrid's index order, and the dual field that certifies how good it is.
struct TvL1Solution {
  int nx = 0, ny = 0, nz = 0;
  Field<float> phi;
  Field<float> px, py, pz;
  int iterations = 0;  ///< done at full resolution

  void reset(int x, int y, int z);
};

struct PrimalDualGap {
  double primal = 0;  ///< sum |grad phi| + lambda sum n |phi - c|
  double dual = 0;    ///< lower bound of the minimum
  double relative() const { return primal > 0 ? (primal - dual) / primal : 0; }
};

/// Chambolle-Pock primal-dual iterations (sigma tau 12 <= 1) started coarse to fine. The fields are swept once an
/// iteration, threads take slabs in z; the result does not depend on the number of threads.
/// Throws std::invalid_argument for empty histograms or bad settings.
TvL1Solution solveTvL1(const Histograms<std::uint8_t>& votes, const TvL1Settings& settings = {});

/// `iterations` of the same from the given start, written plainly: whole-array passes, the proximal step by sorting.
void iterateTvL1Reference(const Histograms<std::uint8_t>& votes, double lambda, int iterations, TvL1Solution* solution);

/// `iterations` of the fast schedule from the given start (ubar = phi at the start).
void iterateTvL1(const Histograms<std::uint8_t>& votes, double lambda, int iterations, int threads,
                 TvL1Solution* solution);

/// Primal energy and dual bound, computed in double independently of the solver.
PrimalDualGap gapTvL1(const Histograms<std::uint8_t>& votes, double lambda, const TvL1Solution& solution,
                      int threads = 2);

}  // namespace dense_fusion
