// Hot loops on plain arrays, compiled for several instruction sets; see zmssd_kernel.cpp.
#pragma once

#include <cmath>

#include "heightmap_mcl/zmssd.h"

namespace heightmap_mcl::kernel {

constexpr float kBoundOffset = 1000;  // [m] added to what is a bound: one load then tells both

struct GroundView {
  const float* heights;  // row-major, NaN for holes, kBoundOffset higher for bounds, bordered by one cell of holes
  int width, height;     // with the border
};

struct AirView {
  const float *x, *y, *h, *low, *high;  // as in AerialCells; low == high: a height, no edge near
  int n;
};

inline AirView viewOf(const AerialCells& cells) {
  return {cells.x.data(),   cells.y.data(),    cells.h.data(),
          cells.low.data(), cells.high.data(), static_cast<int>(cells.h.size())};
}

/// To cells of the bordered grid: column = c*x - s*y + x0, row = s*x + c*y + y0.
struct ToCells {
  float c, s, x0, y0;

  /// `x`, `y`: the grid's corner [m].
  ToCells(const PlanarPose& pose, double resolution, double x, double y)
      : c(static_cast<float>(std::cos(pose.yaw) / resolution)),
        s(static_cast<float>(std::sin(pose.yaw) / resolution)),
        x0(static_cast<float>((pose.x - x) / resolution)),
        y0(static_cast<float>((pose.y - y) / resolution)) {}
};

OverlapSums overlapSums(const AirView& air, const ToCells& to_cells, const GroundView& ground);

/// Over the cells defined in both maps. `limits`: see agreement.h [m].
struct AgreementLimits {
  float offset, cutoff, agreeing, raised;
};
struct AgreementSums {
  double n = 0;
  double squares = 0;            ///< of the residuals, none beyond the cutoff
  double raised = 0, agree = 0;  ///< cells with something on them, and those of them that agree
  double inliers = 0, d = 0;     ///< cells with a height in both that differ by less than the cutoff, and their sum
};
AgreementSums agreementSums(const AirView& air, const ToCells& to_cells, const GroundView& ground,
                            const AgreementLimits& limits);

/// In the order of OverlapSums.
constexpr int kSums = 8;

/// Spectra of mask, heights and squared heights.
struct MapSpectra {
  const float *mask, *h, *h2;
};
/// Products of one heading's spectra, interleaved complex arrays of n elements: the spectra of the sums. `known`: cells
/// with a height; `all`: with bounds at their levels. Where neither map has bounds, out[1] and out[6] are not written.
/// `opposite`: a in place of conj(a), which is the aerial map turned by half a turn.
void correlate(const MapSpectra& air_known, const MapSpectra& air_all, const MapSpectra& ground_known,
               const MapSpectra& ground_all, int n, bool bounds, bool opposite, float* const out[kSums]);

/// out += conj(a) b, or a b, interleaved complex arrays of n elements.
void addCorrelation(const float* a, const float* b, int n, bool opposite, float* out);
/// out += a, arrays of n elements.
void addTo(const float* a, int n, float* out);

/// Scores for a row of n offsets from the inverse transforms of correlate's products (each still to be multiplied by
/// `scale`). score[i] = infinity where the overlap is below min_overlap. cells: defined cells of the smaller map.
void scoreRow(const float* const sums[kSums], int n, float scale, float cells, const CostSettings& settings,
              float* score);

}  // namespace heightmap_mcl::kernel
