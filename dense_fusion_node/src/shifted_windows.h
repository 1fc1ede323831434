// Edges of depth maps where they are: a window that straddles one finds either surface, and carries it over the edge.
#pragma once

#include "dense_fusion/depth_map.h"

namespace dense_fusion {

/// Shiftable windows (Kang, Szeliski and Chai, CVPR 2001): of all windows that hold a pixel, not only the one around
/// it, the best one tells its depth. A window's best cost over depths does not depend on the pixel, so that is the
/// depth of the neighbour within `radius` whose `cost` is least. Taken where that depth is another one (2 %), and the
/// cost less than four fifths of what neighbours of the pixel's own depth have: on one surface each window keeps its
/// own. `cost`: CV_32F, of the windows around the pixels, a sample; not read where the depth is unknown.
void takeBestWindows(const cv::Mat& cost, int radius, int threads, DepthMap* map);

}  // namespace dense_fusion
