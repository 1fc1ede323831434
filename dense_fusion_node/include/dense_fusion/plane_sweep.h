// Depth of a reference view by sweeping a fronto-parallel plane through inverse depth (paper A, section V; Collins
// 1996).
#pragma once

#include <cstdint>
#include <vector>

#include "dense_fusion/cost_kernels.h"
#include "dense_fusion/depth_map.h"
#include "dense_fusion/rectifier.h"

namespace dense_fusion {

struct PlaneSweepSettings {
  int hypotheses = 200;            ///< planes, evenly spaced in inverse depth, 16..1000
  int aggregation_radius = 2;      ///< costs are summed over a window of 2 r + 1 pixels before the winner is taken
  int max_frames = 60;             ///< further frames are refused (64 fill the 16-bit sums)
  int min_samples = 3;             ///< frames a pixel must be seen in beside the reference
  double min_parallax = 2.0;       ///< shift of a pixel between the first and last plane, RMS over the frames [px]
  double max_peak_ratio = 0.85;    ///< best cost over the best one elsewhere; above it a pixel is ambiguous
  double confidence_sigma = 0.03;  ///< standard deviation of depth at which confidence is halved [m]
  double min_confidence = 0.25;    ///< pixels below it are rejected, 0..1
  int threads = 2;
};

/// Squared differences of one reference image with many frames, summed per pixel and hypothesis. They are summed when
/// the depth map is asked for, row by row over all frames, so that a row's costs stay in the cache: the whole volume
/// (36 MB of 376x240x200) would go through memory with every frame.
class PlaneSweep {
 public:
  /// `camera`: undistorted pinhole of all frames. Throws std::invalid_argument for bad settings or a distorted camera.
  PlaneSweep(const air_ground_common::CameraModel& camera, const PlaneSweepSettings& settings = {});

  /// Forgets all frames. Depth range in metres, 1e-6 <= depth_min < depth_max; throws std::invalid_argument otherwise.
  void start(const Frame& reference, double depth_min, double depth_max);
  bool started() const { return started_; }

  /// Adds a frame. False, and no change, when there are max_frames or no pixel of the reference is seen by it.
  bool add(const Frame& frame);

  const Frame& reference() const { return reference_; }
  /// The map was corrected: where the reference is in it now, for frames to come. What was added stays.
  void moveReference(const Eigen::Isometry3d& T_map_camera) { reference_.T_map_camera = T_map_camera; }
  int frames() const { return static_cast<int>(views_.size()); }  ///< added so far, without the reference
  bool full() const { return frames() >= settings_.max_frames; }
  /// RMS shift of a pixel over the frames between the nearest and the farthest plane [px].
  double parallax() const;
  double inverseDepth(int hypothesis) const { return inverse_depth_[hypothesis]; }  ///< [1/m], rising

  /// Winner takes all with a quadratic fit around it. Confidence is the product of how unique the winner is and of how
  /// well its valley fixes the depth: with cost S(rho) ~ S0 + a (rho - rho0)^2 over n samples, var(rho) = S0 / (n a).
  /// Beside edges a pixel lies on that of the surfaces there which its own 3x3 neighbourhood prefers. `few`: so far
  /// apart are the frames that pixels seen in two of them count, too, if they are far from ambiguous.
  DepthMap depthMap(bool few = false) const;

 private:
  /// A frame as the reference's pixels see it.
  struct View {
    std::vector<kernels::RowOfFrame> rows;
    std::vector<int> x0, x1;            ///< of each row: pixels that it sees at all depths
    std::vector<int> between;           ///< of each row: kernels::hypothesesBetween
    std::vector<std::uint32_t> packed;  ///< kernels::packNeighborhoods
  };
  /// Columns [begin, end) of the reference, narrow enough that their costs stay in the cache from row to row. In the
  /// arrays below x lies at x - begin + aggregation_radius; what is outside the image stays zero.
  struct Strip {
    int begin, end;
    int stride;
  };
  struct CostRow {
    std::vector<std::uint16_t> cost;     ///< [hypothesis][stride]
    std::vector<std::uint16_t> samples;  ///< [stride], frames behind each pixel
  };
  /// Of a row of a strip, from its `begin` on: costs of the windows, [hypothesis][stride], and who wins.
  struct Winners {
    std::vector<std::uint32_t> cost, best, second, samples;
    std::vector<std::int32_t> index;
  };

  /// How the costs of windows become depths.
  struct Judgement {
    int half_width;     ///< of the fitted parabola [hypotheses]
    int least_samples;  ///< frames a pixel must be seen in
  };

  void sweepStrip(const Strip& strip, int first, int last, const Judgement& judgement, DepthMap* map,
                  cv::Mat* cost) const;
  void sumCosts(int y, const Strip& strip, CostRow* row) const;
  void estimateRow(int y, const Strip& strip, const Winners& winners, const CostRow& own, const Judgement& judgement,
                   DepthMap* map, cv::Mat* cost) const;
  /// `cost`: of the windows around the pixels, a sample.
  void chooseSurfaces(const cv::Mat& cost, DepthMap* map) const;
  /// Of the 3x3 pixels around each pixel `x` of row y, at its inverse depth `rho`.
  std::vector<float> costsAround(int y, const std::vector<std::int32_t>& x, const std::vector<float>& rho) const;

  air_ground_common::CameraModel camera_;
  PlaneSweepSettings settings_;
  Frame reference_;
  bool started_ = false;
  double squared_parallax_ = 0;
  std::vector<float> inverse_depth_;
  std::vector<View> views_;
};

}  // namespace dense_fusion
