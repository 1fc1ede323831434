// The order in which primal-dual iterations visit the rows of a volume.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "dense_fusion/tv_l1.h"

namespace dense_fusion {

/// Iterations of equation 1 in place. Several of them pass over the volume together, each a slice of z and a row of y
/// behind the one before, so that what one leaves in the cache the next still finds there. Stretches of rows that did
/// not change in the last iteration, and with neighbours that did not, would not change in the next: they are left out.
/// Both change the order alone: results are those of whole-volume iterations, for any number of threads.
template <typename Count>
class TvL1Sweep {
 public:
  /// tau = sigma = `step`. Starts with ubar = phi.
  TvL1Sweep(const Histograms<Count>& votes, float lambda, float step, TvL1Solution* solution);
  void run(int iterations, int threads);

 private:
  using Mask = std::uint16_t;  // one bit a stretch of a row

  void findVotes(int threads);
  void sweepBand(int band, int together);
  void iterateRow(int iteration, int y, int z);
  Mask* changed(int iteration, int y, int z) {
    return &changed_[(static_cast<std::size_t>(iteration) * (nz_ + 2) + z + 1) * (ny_ + 2) + y + 1];
  }

  const Histograms<Count>& votes_;
  const float lambda_, step_;
  TvL1Solution& s_;
  const int nx_, ny_, nz_;
  const std::size_t slice_;
  int stretch_, stretches_;
  Field<float> ubar_;
  const std::vector<float> zeros_;
  std::vector<Mask> voted_;  // stretches with any vote, [z][y]
  // Stretches that an iteration changed, [iteration of this pass; 0 is the last before][z][y] with a border of zeros.
  std::vector<Mask> changed_;
  std::unique_ptr<std::atomic<int>[]> progress_;  // of each band: steps done
};

}  // namespace dense_fusion
