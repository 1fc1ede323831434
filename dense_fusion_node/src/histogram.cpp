#include "dense_fusion/histogram.h"

#include <algorithm>

#include "air_ground_common/first_exception.h"

namespace dense_fusion {
namespace {

template <typename Count>
Histograms<std::uint16_t> halveAny(const Histograms<Count>& fine, int threads) {
  Histograms<std::uint16_t> coarse;
  coarse.resize((fine.nx + 1) / 2, (fine.ny + 1) / 2, (fine.nz + 1) / 2);
  air_ground_common::FirstException failure;
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int Z = 0; Z < coarse.nz; ++Z)
    failure.guard([&] {
      // One more entry for odd widths stays zero.
      std::vector<std::uint16_t> sum(static_cast<std::size_t>(fine.nx) + 1);
      for (int Y = 0; Y < coarse.ny; ++Y)
        for (int k = 0; k < kBins; ++k) {
          std::fill(sum.begin(), sum.end(), 0);
          for (int z = 2 * Z; z < std::min(2 * Z + 2, fine.nz); ++z)
            for (int y = 2 * Y; y < std::min(2 * Y + 2, fine.ny); ++y) {
              const Count* in = fine.row(y, z) + static_cast<std::size_t>(k) * fine.nx;
              for (int x = 0; x < fine.nx; ++x) sum[x] = static_cast<std::uint16_t>(sum[x] + in[x]);
            }
          std::uint16_t* out = coarse.row(Y, Z) + static_cast<std::size_t>(k) * coarse.nx;
          for (int X = 0; X < coarse.nx; ++X) out[X] = static_cast<std::uint16_t>(sum[2 * X] + sum[2 * X + 1]);
        }
    });
  failure.rethrow();
  return coarse;
}

}  // namespace

Histograms<std::uint16_t> halve(const Histograms<std::uint8_t>& fine, int threads) { return halveAny(fine, threads); }
Histograms<std::uint16_t> halve(const Histograms<std::uint16_t>& fine, int threads) { return halveAny(fine, threads); }

}  // namespace dense_fusion
