#include "shifted_windows.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace dense_fusion {
namespace {

constexpr float kOtherDepth = 0.02f;
constexpr float kBetter = 0.8f;

}  // namespace

void takeBestWindows(const cv::Mat& cost, int radius, int threads, DepthMap* map) {
  const cv::Mat depth = map->depth.clone(), confidence = map->confidence.clone();
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int y = 0; y < depth.rows; ++y)
    for (int x = 0; x < depth.cols; ++x) {
      const float own = depth.at<float>(y, x);
      if (std::isnan(own)) continue;
      float least_own = std::numeric_limits<float>::infinity(), least_other = least_own;
      cv::Point other;
      for (int v = std::max(0, y - radius); v <= std::min(depth.rows - 1, y + radius); ++v)
        for (int u = std::max(0, x - radius); u <= std::min(depth.cols - 1, x + radius); ++u) {
          const float z = depth.at<float>(v, u);
          if (std::isnan(z)) continue;
          const float c = cost.at<float>(v, u);
          if (std::abs(z - own) < kOtherDepth * own) {
            least_own = std::min(least_own, c);
          } else if (c < least_other) {
            least_other = c;
            other = {u, v};
          }
        }
      if (!(least_other < kBetter * least_own)) continue;
      map->depth.at<float>(y, x) = depth.at<float>(other);
      map->confidence.at<float>(y, x) = confidence.at<float>(other);
    }
}

}  // namespace dense_fusion
