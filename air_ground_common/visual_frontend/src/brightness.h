// Light that changes from image to image: lamps flicker, exposures leap.
#pragma once

#include <opencv2/core/mat.hpp>

namespace visual_frontend {

/// How many times as bright as the image before (both CV_8UC1) the scene is, where that is a leap of 8 % or more, else
/// 1. By the median of the image's parts: a bright window that comes into view is no leap.
double brightnessLeap(const cv::Mat& before, const cv::Mat& now);

}  // namespace visual_frontend
