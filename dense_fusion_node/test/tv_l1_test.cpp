#include "dense_fusion/tv_l1.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace dense_fusion {
namespace {

// Histograms as of `maps` distance fields around a tilted plane with a share of outliers.
Histograms<std::uint8_t> planeVotes(int nx, int ny, int nz, int maps, double outliers, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, 0.25);
  std::uniform_real_distribution<double> uniform(0, 1);
  Histograms<std::uint8_t> votes;
  votes.resize(nx, ny, nz);
  for (int z = 0; z < nz; ++z)
    for (int y = 0; y < ny; ++y)
      for (int x = 0; x < nx; ++x)
        for (int m = 0; m < maps; ++m) {
          double f = (z - 0.5 * nz - 0.1 * x) / 4 + noise(random);
          if (uniform(random) < outliers) f = 2 * uniform(random) - 1;
          if (f < -1) continue;
          const int bin = static_cast<int>(std::lround((std::min(f, 1.0) + 1) * 0.5 * (kBins - 1)));
          ++votes.row(y, z)[bin * nx + x];
        }
  return votes;
}

double largestDifference(const Field<float>& a, const Field<float>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(double(a[i]) - b[i]));
  return largest;
}

TEST(TvL1, FastScheduleMatchesTheReferenceOnRandomHistograms) {
  for (const auto& size : {std::array<int, 3>{33, 17, 9}, {8, 8, 8}, {64, 3, 2}, {5, 4, 1}, {210, 37, 11}}) {
    Histograms<std::uint8_t> votes;
    votes.resize(size[0], size[1], size[2]);
    std::mt19937 random(5);
    for (auto& c : votes.counts) c = static_cast<std::uint8_t>(random() % 3 ? 0 : random() % 5);
    // Beside the surfaces free space, which settles, and the unseen, without votes.
    for (int z = 0; z < votes.nz; ++z)
      for (int y = 0; y < votes.ny; ++y)
        for (int k = 0; k < kBins; ++k)
          for (int x = 65; x < votes.nx; ++x) votes.row(y, z)[k * votes.nx + x] = x < 150 && k == kBins - 1 ? 6 : 0;
    for (const int threads : {1, 2, 3}) {
      TvL1Solution fast, plain;
      fast.reset(size[0], size[1], size[2]);
      plain.reset(size[0], size[1], size[2]);
      iterateTvL1(votes, 0.26, 19, threads, &fast);
      iterateTvL1Reference(votes, 0.26, 19, &plain);
      EXPECT_LT(largestDifference(fast.phi, plain.phi), 2e-4) << "threads " << threads;
      EXPECT_LT(largestDifference(fast.pz, plain.pz), 2e-4) << "threads " << threads;
    }
  }
}

TEST(TvL1, GapFallsBelowOnePercentSoTheSolutionIsOptimal) {
  const auto votes = planeVotes(40, 36, 32, 6, 0.12, 1);
  TvL1Settings settings;
  settings.iterations = 2000;
  settings.relative_gap = 0.005;
  const TvL1Solution solution = solveTvL1(votes, settings);
  const PrimalDualGap gap = gapTvL1(votes, settings.lambda, solution);
  EXPECT_GE(gap.primal, gap.dual);
  EXPECT_LT(gap.relative(), 0.01);
  EXPECT_LT(solution.iterations, 2000);
  for (std::size_t i = 0; i < solution.phi.size(); ++i) {
    ASSERT_LE(std::abs(solution.phi[i]), 1.f);
    const double norm = std::hypot(solution.px[i], solution.py[i], solution.pz[i]);
    ASSERT_LE(norm, 1 + 1e-5);
  }
}

TEST(TvL1, CoarseStartBeatsColdStartAfterEightIterations) {
  const auto votes = planeVotes(64, 48, 40, 6, 0.12, 2);
  TvL1Settings settings;
  settings.iterations = 1500;
  settings.relative_gap = 0.001;
  const double optimum = gapTvL1(votes, settings.lambda, solveTvL1(votes, settings)).dual;
  settings.relative_gap = 0;
  settings.iterations = 8;
  const double warm = gapTvL1(votes, settings.lambda, solveTvL1(votes, settings)).primal / optimum - 1;
  settings.coarse_levels = 0;
  const double cold = gapTvL1(votes, settings.lambda, solveTvL1(votes, settings)).primal / optimum - 1;
  std::printf("energy above the optimum after 8 iterations: cold %.1f %%, coarse to fine %.1f %%\n", 100 * cold,
              100 * warm);
  EXPECT_LT(warm, 0.08);
  EXPECT_LT(warm, 0.7 * cold);
}

TEST(TvL1, RefusesBadSettings) {
  Histograms<std::uint8_t> votes;
  EXPECT_THROW(solveTvL1(votes), std::invalid_argument);
  votes.resize(4, 4, 4);
  TvL1Settings settings;
  settings.lambda = 0;
  EXPECT_THROW(solveTvL1(votes, settings), std::invalid_argument);
}

}  // namespace
}  // namespace dense_fusion
