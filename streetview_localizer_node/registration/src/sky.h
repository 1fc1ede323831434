// Where the sky ends: one row a column of a level panorama.
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace streetview_localizer::registration {

struct SkyLine {
  std::vector<float> row;  ///< of each column: sky above it; sub-pixel; NaN outside the mask
  std::string failure;     ///< why there is none, else empty
};

/// Divides each column once: sky above, everything else below. Colours and smoothness of both sides are learned from
/// this image alone, from the zenith and the horizon inwards, and the line is the cheapest path around the image.
SkyLine findSkyLine(const cv::Mat& bgr, const cv::Mat& mask);

}  // namespace streetview_localizer::registration
