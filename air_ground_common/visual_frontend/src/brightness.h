// Light that changes from image to image: lamps flicker, in bands where rows are exposed one after the other; exposures
// leap.
#pragma once

#include <opencv2/core/mat.hpp>

namespace visual_frontend {

/// How many times as bright as in the image before (both CV_8UC1) the scene is, by row (CV_32F, a column), where that
/// is a leap of 8 % or more; else empty. By medians of the image's parts: a bright window that comes into view is no
/// leap.
cv::Mat brightnessLeap(const cv::Mat& before, const cv::Mat& now);

/// Each row of a CV_8UC1 image so many times as bright.
cv::Mat brightened(const cv::Mat& image, const cv::Mat& gain_of_rows);

}  // namespace visual_frontend
