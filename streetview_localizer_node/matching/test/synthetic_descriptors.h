// Descriptors that cluster like those of buildings, for tests and benchmarks where no photographs are at hand.
#pragma once

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "streetview_localizer/features.h"

namespace streetview_localizer {

/// RootSIFT of `count` histograms: clusters of 20 around sparse centres, whose elements scatter.
inline cv::Mat syntheticDescriptors(int count, unsigned seed) {
  constexpr int kCluster = 20;
  std::mt19937 random(seed);
  std::exponential_distribution<float> value(1.f / 25);
  std::normal_distribution<float> scatter(0, 12);
  std::bernoulli_distribution present(0.6);
  cv::Mat sift(count, 128, CV_32F);
  std::vector<float> centre(128);
  for (int i = 0; i < count; ++i) {
    if (i % kCluster == 0)
      for (float& c : centre) c = present(random) ? value(random) : 0;
    for (int e = 0; e < 128; ++e)
      sift.at<float>(i, e) = std::clamp(std::round(centre[e] + scatter(random)), 0.f, 150.f);
  }
  return rootSift(sift);
}

/// `count` rows spread over `descriptors`, disturbed as by another view.
inline cv::Mat disturbed(const cv::Mat& descriptors, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> noise(0, 10);
  cv::Mat out(count, 128, CV_8U);
  for (int i = 0; i < count; ++i) {
    const int row = static_cast<int>(static_cast<std::int64_t>(i) * descriptors.rows / count);
    for (int e = 0; e < 128; ++e)
      out.at<unsigned char>(i, e) =
          cv::saturate_cast<unsigned char>(descriptors.at<unsigned char>(row, e) + noise(random));
  }
  return out;
}

}  // namespace streetview_localizer
