// Step 5 of the matching: k-VLD. Two matches support each other when the image looks alike along the virtual lines that
// join their keypoints in either image, and when each predicts the other's place; a match without k supporters is
// dropped. Written from Z. Liu and R. Marlet, "Virtual Line Descriptor and Semi-Local Matching Method for Reliable
// Feature Correspondence", BMVC 2012.
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct KvldSettings {
  int min_supporters = 3;          ///< K of the paper
  double max_photometric = 0.25;   ///< largest distance of two line descriptors, in [0, 1] (tau; the paper has 0.35)
  double max_geometric = 0.5;      ///< largest mean relative error of the predicted places (chi)
  double histogram_weight = 0.36;  ///< of the histograms; the rest is the main directions' (beta)
  double min_length = 15;          ///< of a line, in either image [px]
  double max_length = 200;         ///< [px]
  int max_lines = 10;              ///< from one match, to the nearest that are geometrically consistent
  /// Not in the paper, which looks at neighbours only and so keeps a whole window that is matched to another, equal
  /// one, and a mirrored facade window by window. Smallest share of triangles with other survivors that turn the same
  /// way in both images; when fewer than half of the survivors reach it, none is kept. 0: off.
  double min_order_agreement = 0.7;
};

/// Gradients of an image and its halvings: what line descriptors are read from. Make once an image, use for many
/// matchings.
class GradientPyramid {
 public:
  /// 8-bit image, grey or BGR. Throws std::invalid_argument for another type.
  explicit GradientPyramid(const cv::Mat& image);

  struct Gradient {
    std::uint16_t magnitude;  ///< of the Scharr filter
    std::uint16_t angle;      ///< 65536 to the turn, from x towards y
  };
  struct Level {
    int width, height;
    std::vector<Gradient> gradients;
  };
  const std::vector<Level>& levels() const { return levels_; }
  std::size_t bytes() const;  ///< that it holds

 private:
  std::vector<Level> levels_;
};

/// Descriptor of a virtual line: U = 10 overlapping disks along it, each with a histogram of V = 8 gradient directions
/// relative to the line's, weighted by magnitude, and with its main direction among W = 24.
struct LineDescriptor {
  static constexpr int kDisks = 10, kHistogram = 8, kDirections = 24;
  float histogram[kDisks][kHistogram];  ///< sums to 1 over the line
  int main_direction[kDisks];
  float contrast[kDisks];  ///< of the main direction: its share of the disk, times the square root of the disk's share
                           ///< of the line
  bool valid = false;      ///< false: the line leaves the image, or crosses nothing but a blank wall
};

LineDescriptor describeLine(const GradientPyramid& pyramid, cv::Point2f from, cv::Point2f to);

/// Distance of two lines, in [0, 1]: histogram_weight times half the L1 distance of the histograms, plus the rest times
/// the contrast-weighted mean angle between the main directions, over half a turn. 1 when one is not valid.
double lineDistance(const LineDescriptor& a, const LineDescriptor& b, double histogram_weight = 0.36);

/// Mean over both matches and both images of |predicted - observed| / |observed| for the vector to the other match,
/// predicted by the similarity that a match's two keypoints define.
double geometricInconsistency(const cv::KeyPoint& query_i, const cv::KeyPoint& view_i, const cv::KeyPoint& query_j,
                              const cv::KeyPoint& view_j);

struct KvldResult {
  std::vector<int> kept;        ///< indices into the matches, ascending
  std::vector<int> supporters;  ///< of each kept match
};

/// Runs in OpenMP threads; the result does not depend on their number.
KvldResult filterKvld(const GradientPyramid& query_image, const GradientPyramid& view_image,
                      const std::vector<cv::KeyPoint>& query, const std::vector<cv::KeyPoint>& view,
                      const std::vector<Match>& matches, const KvldSettings& settings = {});

}  // namespace streetview_localizer
