// Which other surface a pixel beside a depth edge may lie on.
#pragma once

#include <opencv2/core/mat.hpp>

namespace dense_fusion {

/// Shiftable windows (Kang, Szeliski and Chai, CVPR 2001): of the windows of 2 radius + 1 pixels that hold a pixel, the
/// one that costs least at another depth (by 2 % or more) than the pixel has. A window's best cost is the same for all
/// pixels in it, so that is the neighbour within `radius` of least `cost` (CV_32F; not read where the depth is
/// unknown). Returns its index, row * columns + column, -1 where there is none: CV_32S. `depth`: CV_32F, NaN where
/// unknown.
cv::Mat otherSurfaces(const cv::Mat& depth, const cv::Mat& cost, int radius, int threads);

}  // namespace dense_fusion
