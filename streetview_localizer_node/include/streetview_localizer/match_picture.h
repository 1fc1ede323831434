// A match as a picture: the image, the database's view, and lines between what was matched.
#pragma once

#include <opencv2/core.hpp>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// BGR: the image on the left, on the right that view which the match rests on (blank without one), both `height`
/// pixels high. Inliers are joined in green, matches that the pose contradicts in red (at most `max_lines` of either);
/// below, status and reason.
cv::Mat drawMatch(const cv::Mat& image, const StreetviewDatabase& database, const LocalizerResult& result,
                  int height = 480, int max_lines = 150);

/// BGR: the image on the left, on the right what the textured model shows from the estimated pose (paper B, figure 5
/// e-f).
cv::Mat drawBeside(const cv::Mat& image, const cv::Mat& synthesized);

}  // namespace streetview_localizer
