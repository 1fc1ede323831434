#include "visual_frontend/image_noise.h"

#include <opencv2/imgproc.hpp>

namespace visual_frontend {

bool isNoise(const cv::Mat& gray) {
  constexpr double kShrink = 1 / 8.0, kLeft = 0.2;
  if (gray.cols < 64 || gray.rows < 64) return false;
  cv::Mat small;
  cv::resize(gray, small, {}, kShrink, kShrink, cv::INTER_AREA);
  cv::Scalar mean, all, coarse;
  cv::meanStdDev(gray, mean, all);
  cv::meanStdDev(small, mean, coarse);
  return coarse[0] < kLeft * all[0];
}

}  // namespace visual_frontend
