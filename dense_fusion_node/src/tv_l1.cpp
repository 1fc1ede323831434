#include "dense_fusion/tv_l1.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "air_ground_common/first_exception.h"
#include "tv_l1_sweep.h"

namespace dense_fusion {
namespace {

// |grad|^2 <= 12 in three dimensions: steps of 1 / sqrt(12) each converge (Chambolle and Pock 2011).
constexpr float kStep = 0.288675f;

// One call runs all iterations; ubar lives only here.
template <typename Count>
void iterate(const Histograms<Count>& votes, double lambda, int iterations, int threads, TvL1Solution* s) {
  TvL1Sweep<Count>(votes, static_cast<float>(lambda), kStep, s).run(iterations, threads);
  s->iterations += iterations;
}

// Coarse neighbours of a fine position and the weight of the second one. Values at cell centres: fine 2X, 2X + 1 lie a
// quarter of a coarse cell before and behind coarse X. Duals along their own axis live on faces: fine face 2X + 1 is
// coarse face X, fine face 2X lies half way between coarse faces X - 1 and X.
struct Tap {
  int a, b;
  float weight;
};

std::vector<Tap> taps(int fine, int coarse, bool faces) {
  std::vector<Tap> result(fine);
  for (int i = 0; i < fine; ++i) {
    const int X = i / 2;
    Tap t{X, X, 0.f};
    if (faces) {
      if (i % 2 == 0) t = {std::max(0, X - 1), X, X == 0 ? 1.f : 0.5f};
    } else {
      t.b = i % 2 ? X + 1 : X - 1;
      t.weight = 0.25f;
    }
    t.b = std::clamp(t.b, 0, coarse - 1);
    result[i] = t;
  }
  return result;
}

// The same along a row, without tables: `in` has one more value at each end.
void widen(const float* __restrict in, int n, bool faces, float* __restrict out) {
  if (faces) {
    for (int x = 0; x < n; ++x) {
      out[2 * x] = in[x - 1] + 0.5f * (in[x] - in[x - 1]);
      out[2 * x + 1] = in[x];
    }
  } else {
    for (int x = 0; x < n; ++x) {
      out[2 * x] = in[x] + 0.25f * (in[x - 1] - in[x]);
      out[2 * x + 1] = in[x] + 0.25f * (in[x + 1] - in[x]);
    }
  }
}

void upsample(const Field<float>& from, const TvL1Solution& coarse, const TvL1Solution& fine, int face_axis,
              int threads, Field<float>* to) {
  const auto ty = taps(fine.ny, coarse.ny, face_axis == 1), tz = taps(fine.nz, coarse.nz, face_axis == 2);
  const auto row = [&](int y, int z) { return &from[(static_cast<std::size_t>(z) * coarse.ny + y) * coarse.nx]; };
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int z = 0; z < fine.nz; ++z)
    failure.guard([&] {
      std::vector<float> padded(coarse.nx + 2), twice(2 * static_cast<std::size_t>(coarse.nx));
      float* blended = padded.data() + 1;
      for (int y = 0; y < fine.ny; ++y) {
        const Tap &v = ty[y], &w = tz[z];
        const float *aa = row(v.a, w.a), *ba = row(v.b, w.a), *ab = row(v.a, w.b), *bb = row(v.b, w.b);
        for (int x = 0; x < coarse.nx; ++x) {
          const float low = aa[x] + v.weight * (ba[x] - aa[x]), high = ab[x] + v.weight * (bb[x] - ab[x]);
          blended[x] = low + w.weight * (high - low);
        }
        blended[-1] = blended[0];
        blended[coarse.nx] = blended[coarse.nx - 1];
        widen(blended, coarse.nx, face_axis == 0, twice.data());
        std::copy_n(twice.data(), fine.nx, &(*to)[(static_cast<std::size_t>(z) * fine.ny + y) * fine.nx]);
      }
    });
  failure.rethrow();
}

// Start of a finer level by linear interpolation; duals across the far borders are zero (Neumann).
TvL1Solution refineSolution(const TvL1Solution& coarse, int nx, int ny, int nz, int threads) {
  TvL1Solution fine;
  fine.nx = nx;
  fine.ny = ny;
  fine.nz = nz;
  for (auto* field : {&fine.phi, &fine.px, &fine.py, &fine.pz}) field->resize(static_cast<std::size_t>(nx) * ny * nz);
  upsample(coarse.phi, coarse, fine, -1, threads, &fine.phi);
  upsample(coarse.px, coarse, fine, 0, threads, &fine.px);
  upsample(coarse.py, coarse, fine, 1, threads, &fine.py);
  upsample(coarse.pz, coarse, fine, 2, threads, &fine.pz);
  const auto zero = [&](Field<float>* field, int x0, int y0, int z0) {
    for (int z = z0; z < nz; ++z)
      for (int y = y0; y < ny; ++y)
        for (int x = x0; x < nx; ++x) (*field)[(static_cast<std::size_t>(z) * ny + y) * nx + x] = 0;
  };
  zero(&fine.px, nx - 1, 0, 0);
  zero(&fine.py, 0, ny - 1, 0);
  zero(&fine.pz, 0, 0, nz - 1);
  return fine;
}

void checkSettings(const TvL1Settings& s) {
  if (!(s.lambda > 0)) throw std::invalid_argument("TV-L1: lambda must be positive");
  if (s.iterations < 1 || s.coarse_iterations < 1 || s.coarse_levels < 0 || s.coarse_levels > 3 || s.threads < 1)
    throw std::invalid_argument(
        "TV-L1: iterations, coarse_iterations and threads must be positive, coarse_levels 0..3");
}

}  // namespace

void TvL1Solution::reset(int x, int y, int z) {
  nx = x;
  ny = y;
  nz = z;
  const std::size_t n = static_cast<std::size_t>(x) * y * z;
  for (auto* field : {&phi, &px, &py, &pz}) field->assign(n, 0.f);
  iterations = 0;
}

void iterateTvL1(const Histograms<std::uint8_t>& votes, double lambda, int iterations, int threads,
                 TvL1Solution* solution) {
  iterate(votes, lambda, iterations, threads, solution);
}

TvL1Solution solveTvL1(const Histograms<std::uint8_t>& votes, const TvL1Settings& settings) {
  checkSettings(settings);
  if (votes.counts.empty()) throw std::invalid_argument("TV-L1: the histograms are empty");
  std::vector<Histograms<std::uint16_t>> coarse;
  for (int level = 0; level < settings.coarse_levels; ++level)
    coarse.push_back(level == 0 ? halve(votes, settings.threads) : halve(coarse.back(), settings.threads));
  TvL1Solution solution;
  if (coarse.empty()) {
    solution.reset(votes.nx, votes.ny, votes.nz);
  } else {
    solution.reset(coarse.back().nx, coarse.back().ny, coarse.back().nz);
    int iterations = settings.coarse_iterations;
    for (int level = settings.coarse_levels - 1; level >= 0; --level) {
      // A coarse voxel sums the counts of 2^3 fine ones, one of its faces stands for 2^2: the weight falls by 4 a
      // level.
      const double lambda = settings.lambda / std::pow(4.0, level + 1);
      iterate(coarse[level], lambda, iterations, settings.threads, &solution);
      iterations = std::max(1, iterations / 2);
      if (level > 0)
        solution = refineSolution(solution, coarse[level - 1].nx, coarse[level - 1].ny, coarse[level - 1].nz,
                                  settings.threads);
      else
        solution = refineSolution(solution, votes.nx, votes.ny, votes.nz, settings.threads);
    }
  }
  if (settings.relative_gap <= 0) {
    iterate(votes, settings.lambda, settings.iterations, settings.threads, &solution);
    return solution;
  }
  constexpr int kBetweenChecks = 8;
  while (solution.iterations < settings.iterations) {
    iterate(votes, settings.lambda, std::min(kBetweenChecks, settings.iterations - solution.iterations),
            settings.threads, &solution);
    if (gapTvL1(votes, settings.lambda, solution, settings.threads).relative() < settings.relative_gap) break;
  }
  return solution;
}

void iterateTvL1Reference(const Histograms<std::uint8_t>& votes, double lambda, int iterations, TvL1Solution* s) {
  const int nx = s->nx, ny = s->ny, nz = s->nz;
  const auto at = [&](int x, int y, int z) { return (static_cast<std::size_t>(z) * ny + y) * nx + x; };
  const double tau = kStep, sigma = kStep;
  Field<float> ubar = s->phi;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    for (int z = 0; z < nz; ++z)
      for (int y = 0; y < ny; ++y)
        for (int x = 0; x < nx; ++x) {
          const std::size_t i = at(x, y, z);
          const double qx = s->px[i] + (x + 1 < nx ? sigma * (ubar[at(x + 1, y, z)] - ubar[i]) : 0);
          const double qy = s->py[i] + (y + 1 < ny ? sigma * (ubar[at(x, y + 1, z)] - ubar[i]) : 0);
          const double qz = s->pz[i] + (z + 1 < nz ? sigma * (ubar[at(x, y, z + 1)] - ubar[i]) : 0);
          const double scale = 1 / std::max(1.0, std::sqrt(qx * qx + qy * qy + qz * qz));
          s->px[i] = static_cast<float>(qx * scale);
          s->py[i] = static_cast<float>(qy * scale);
          s->pz[i] = static_cast<float>(qz * scale);
        }
    for (int z = 0; z < nz; ++z)
      for (int y = 0; y < ny; ++y)
        for (int x = 0; x < nx; ++x) {
          const std::size_t i = at(x, y, z);
          const double divergence = s->px[i] - (x > 0 ? s->px[at(x - 1, y, z)] : 0) + s->py[i] -
                                    (y > 0 ? s->py[at(x, y - 1, z)] : 0) + s->pz[i] -
                                    (z > 0 ? s->pz[at(x, y, z - 1)] : 0);
          double total = 0, below = 0;
          for (int k = 0; k < kBins; ++k) total += votes.at(x, y, z, k);
          std::array<double, 2 * kBins + 1> candidates;
          for (int k = 0; k < kBins; ++k) candidates[k] = binCenter(k);
          for (int k = 0; k <= kBins; ++k) {
            candidates[kBins + k] = s->phi[i] + tau * divergence + tau * lambda * (total - 2 * below);
            if (k < kBins) below += votes.at(x, y, z, k);
          }
          std::sort(candidates.begin(), candidates.end());
          const float next = static_cast<float>(std::clamp(candidates[kBins], -1.0, 1.0));
          ubar[i] = 2 * next - s->phi[i];
          s->phi[i] = next;
        }
  }
  s->iterations += iterations;
}

PrimalDualGap gapTvL1(const Histograms<std::uint8_t>& votes, double lambda, const TvL1Solution& s, int threads) {
  const int nx = s.nx, ny = s.ny, nz = s.nz;
  const std::size_t slice = static_cast<std::size_t>(nx) * ny;
  std::vector<PrimalDualGap> of_slice(nz);  // summed in order afterwards: independent of the number of threads
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int z = 0; z < nz; ++z) {
    PrimalDualGap gap;
    for (int y = 0; y < ny; ++y)
      for (int x = 0; x < nx; ++x) {
        const std::size_t i = z * slice + static_cast<std::size_t>(y) * nx + x;
        const double u = s.phi[i];
        const double gx = x + 1 < nx ? s.phi[i + 1] - u : 0, gy = y + 1 < ny ? s.phi[i + nx] - u : 0;
        const double gz = z + 1 < nz ? s.phi[i + slice] - u : 0;
        const double divergence = s.px[i] - (x > 0 ? s.px[i - 1] : 0) + s.py[i] - (y > 0 ? s.py[i - nx] : 0) + s.pz[i] -
                                  (z > 0 ? s.pz[i - slice] : 0);
        double data = 0, bound = 1e300;
        for (int k = 0; k < kBins; ++k) data += votes.at(x, y, z, k) * std::abs(u - binCenter(k));
        for (int k = 0; k < kBins; ++k) {
          double cost = -binCenter(k) * divergence;
          for (int j = 0; j < kBins; ++j) cost += lambda * votes.at(x, y, z, j) * std::abs(binCenter(k) - binCenter(j));
          bound = std::min(bound, cost);
        }
        gap.primal += std::sqrt(gx * gx + gy * gy + gz * gz) + lambda * data;
        gap.dual += bound;
      }
    of_slice[z] = gap;
  }
  PrimalDualGap sum;
  for (const PrimalDualGap& gap : of_slice) {
    sum.primal += gap.primal;
    sum.dual += gap.dual;
  }
  return sum;
}

}  // namespace dense_fusion
