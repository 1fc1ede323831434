#include "tv_l1_sweep.h"

#include <omp.h>

#include <algorithm>
#include <chrono>
#include <thread>

#include "dense_fusion/fusion_kernels.h"

namespace dense_fusion {
namespace {

constexpr int kTogether = 8;                       // iterations in one pass
constexpr int kBand = 16;                          // rows of y in a band: with kTogether slices of it the cache is full
constexpr int kMostStretches = 16, kStretch = 64;  // voxels, at least

// Cores shared with others: who does not get on soon sleeps.
void waitFor(const std::atomic<int>& progress, int steps) {
  constexpr int kPolls = 200;
  for (int i = 0; progress.load(std::memory_order_acquire) < steps; ++i)
    if (i < kPolls)
      std::this_thread::yield();
    else
      std::this_thread::sleep_for(std::chrono::microseconds(50));
}

int bands(int ny, int together) { return (ny + together - 1 + kBand - 1) / kBand; }

}  // namespace

template <typename Count>
TvL1Sweep<Count>::TvL1Sweep(const Histograms<Count>& votes, float lambda, float step, TvL1Solution* solution)
    : votes_(votes),
      lambda_(lambda),
      step_(step),
      s_(*solution),
      nx_(s_.nx),
      ny_(s_.ny),
      nz_(s_.nz),
      slice_(static_cast<std::size_t>(nx_) * ny_),
      ubar_(s_.phi),
      zeros_(nx_, 0.f),
      voted_(static_cast<std::size_t>(ny_) * nz_, 0),
      changed_(static_cast<std::size_t>(kTogether + 1) * (nz_ + 2) * (ny_ + 2), 0),
      progress_(new std::atomic<int>[bands(ny_, kTogether)]) {
  stretch_ = std::max(kStretch, (nx_ + kMostStretches - 1) / kMostStretches);
  stretches_ = (nx_ + stretch_ - 1) / stretch_;
  for (int z = 0; z < nz_; ++z) std::fill_n(changed(0, 0, z), ny_, static_cast<Mask>((1u << stretches_) - 1));
}

template <typename Count>
void TvL1Sweep<Count>::run(int iterations, int threads) {
  findVotes(threads);
  for (int done = 0; done < iterations;) {
    const int together = std::min(kTogether, iterations - done), count = bands(ny_, together);
    for (int b = 0; b < count; ++b) progress_[b] = 0;
#pragma omp parallel num_threads(threads)
    for (int b = omp_get_thread_num(); b < count; b += omp_get_num_threads()) sweepBand(b, together);
    std::copy_n(changed(together, -1, -1), static_cast<std::size_t>(nz_ + 2) * (ny_ + 2), changed(0, -1, -1));
    done += together;
  }
}

template <typename Count>
void TvL1Sweep<Count>::findVotes(int threads) {
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int z = 0; z < nz_; ++z)
    for (int y = 0; y < ny_; ++y)
      for (int k = 0; k < stretches_; ++k) {
        const int x = k * stretch_, n = std::min(stretch_, nx_ - x);
        bool any = false;
        for (int bin = 0; bin < kBins && !any; ++bin) {
          const Count* counts = votes_.row(y, z) + static_cast<std::size_t>(bin) * nx_ + x;
          any = std::any_of(counts, counts + n, [](Count c) { return c != 0; });
        }
        voted_[static_cast<std::size_t>(z) * ny_ + y] |= static_cast<Mask>(unsigned(any) << k);
      }
}

// In step s iteration t of the pass works on slice z = s - t and rows [band * kBand - t, (band + 1) * kBand - t). The
// dual of a row needs the rows after it, in y and z, from the iteration before; the primal step the duals of the rows
// before it: these were visited in this band or the one before, and not yet by a later iteration.
template <typename Count>
void TvL1Sweep<Count>::sweepBand(int band, int together) {
  for (int step = 0; step < nz_ + together - 1; ++step) {
    if (band > 0) waitFor(progress_[band - 1], step + 1);
    for (int t = std::max(0, step - nz_ + 1); t < together && t <= step; ++t) {
      const int begin = std::max(0, band * kBand - t), end = std::min(ny_, (band + 1) * kBand - t);
      for (int y = begin; y < end; ++y) iterateRow(t + 1, y, step - t);
    }
    progress_[band].store(step + 1, std::memory_order_release);
  }
}

template <typename Count>
void TvL1Sweep<Count>::iterateRow(int iteration, int y, int z) {
  // All rows whose values this one's new u, ubar or p are made from.
  const Mask* c = changed(iteration - 1, y, z);
  const int next_z = ny_ + 2;
  const unsigned near = c[0] | c[1] | c[-1] | c[next_z] | c[next_z - 1] | c[-next_z] | c[1 - next_z];
  const unsigned active = (near | near << 1 | near >> 1) & ((1u << stretches_) - 1);
  unsigned changes = 0;
  if (active) {
    const std::size_t row = z * slice_ + static_cast<std::size_t>(y) * nx_;
    const std::size_t row_y = y + 1 < ny_ ? row + nx_ : row, row_z = z + 1 < nz_ ? row + slice_ : row;
    const float* py_before = y > 0 ? &s_.py[row - nx_] : zeros_.data();
    const float* pz_before = z > 0 ? &s_.pz[row - slice_] : zeros_.data();
    const Mask voted = voted_[static_cast<std::size_t>(z) * ny_ + y];
    for (int k = 0; k < stretches_; ++k) {
      if (!(active >> k & 1)) continue;
      const int x = k * stretch_, n = std::min(stretch_, nx_ - x);
      changes |= unsigned(kernels::dualRow(&ubar_[row + x], &ubar_[row_y + x], &ubar_[row_z + x], &s_.px[row + x],
                                           &s_.py[row + x], &s_.pz[row + x], n, x + n == nx_, step_))
                 << k;
    }
    for (int k = 0; k < stretches_; ++k) {
      if (!(active >> k & 1)) continue;
      const int x = k * stretch_, n = std::min(stretch_, nx_ - x);
      changes |=
          unsigned(kernels::primalRow(&s_.phi[row + x], &ubar_[row + x], &s_.px[row + x], &s_.py[row + x],
                                      py_before + x, &s_.pz[row + x], pz_before + x,
                                      voted >> k & 1 ? votes_.row(y, z) + x : nullptr, nx_, n, x == 0, step_, lambda_))
          << k;
    }
  }
  *changed(iteration, y, z) = static_cast<Mask>(changes);
}

template class TvL1Sweep<std::uint8_t>;
template class TvL1Sweep<std::uint16_t>;

}  // namespace dense_fusion
