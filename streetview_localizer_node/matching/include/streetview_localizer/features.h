// Step 1 of the matching: SIFT keypoints with RootSIFT descriptors.
#pragma once

#include <opencv2/core.hpp>

#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct FeatureSettings {
  int max_features = 0;              ///< the strongest are kept; 0: all
  double contrast_threshold = 0.04;  ///< of OpenCV's SIFT: lower finds more, weaker keypoints
  double edge_threshold = 10;        ///< largest ratio of the principal curvatures
  bool double_image =
      true;  ///< false: the finest octave is the image itself; a quarter of the time, fewer small keypoints
};

/// Features of an 8-bit image with one channel (or BGR, which is converted). The order is deterministic. Keypoints are
/// in pixels of `image`, (0, 0) the centre of the top-left pixel. Throws std::invalid_argument for another type; an
/// empty image, or one smaller than 32 pixels, has no features. Safe to call from several threads at once. `mask`
/// (CV_8U, optional): keypoints are found where it is not zero.
Features extractFeatures(const cv::Mat& image, const FeatureSettings& settings = {}, const cv::Mat& mask = cv::Mat());

/// RootSIFT (Arandjelovic and Zisserman, CVPR 2012): 512 sqrt(d / |d|_1), rounded, one byte an element. `sift`: n x
/// 128, CV_32F.
cv::Mat rootSift(const cv::Mat& sift);

}  // namespace streetview_localizer
