#include "other_surfaces.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace dense_fusion {

cv::Mat otherSurfaces(const cv::Mat& depth, const cv::Mat& cost, int radius, int threads) {
  constexpr float kOtherDepth = 0.02f;
  cv::Mat others(depth.size(), CV_32S, cv::Scalar(-1));
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int y = 0; y < depth.rows; ++y)
    for (int x = 0; x < depth.cols; ++x) {
      const float own = depth.at<float>(y, x);
      if (std::isnan(own)) continue;
      float least = std::numeric_limits<float>::infinity();
      for (int v = std::max(0, y - radius); v <= std::min(depth.rows - 1, y + radius); ++v)
        for (int u = std::max(0, x - radius); u <= std::min(depth.cols - 1, x + radius); ++u) {
          // False for NaN, too.
          if (!(std::abs(depth.at<float>(v, u) - own) >= kOtherDepth * own) || cost.at<float>(v, u) >= least) continue;
          least = cost.at<float>(v, u);
          others.at<int>(y, x) = v * depth.cols + u;
        }
    }
  return others;
}

}  // namespace dense_fusion
