// Procedural albedo of the materials: noise at every scale, and print, tape, stains, pictures drawn over it.
#pragma once

#include <opencv2/core/mat.hpp>

#include "air_ground_sim/world.h"

namespace air_ground_sim {

/// Paints one patch: CV_8UC3, channels R G B, sRGB-like encoding; size = extent / texel, at least 4 px a side.
/// Row 0 lies at v = 0. The same patch gives the same picture.
cv::Mat paintPatch(const Patch& patch);

}  // namespace air_ground_sim
