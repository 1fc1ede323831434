// Features of an image that was already halved; for virtual views, which are rendered at half their resolution.
#pragma once

#include "streetview_localizer/features.h"

namespace streetview_localizer {

/// As extractFeatures with double_image = false of an image whose pixel x is pixel (x - 0.5) / 2 of `half`.
Features extractHalvedFeatures(const cv::Mat& half, const FeatureSettings& settings,
                               const cv::Mat& half_mask = cv::Mat());

}  // namespace streetview_localizer
