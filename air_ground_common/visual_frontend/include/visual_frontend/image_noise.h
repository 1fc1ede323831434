// Images that show nothing but their sensor's noise.
#pragma once

#include <opencv2/core.hpp>

namespace visual_frontend {

/// A covered lens, or the dark, at a high gain: corners are found in it, and described, though there is nothing to be
/// seen. The mean over 8x8 pixels leaves an eighth of noise, where a scene keeps a third or more. `gray`: CV_8UC1. An
/// even grey is none.
bool isNoise(const cv::Mat& gray);

}  // namespace visual_frontend
