// Depth between the pixels of a depth image.
#pragma once

#include <cstddef>

namespace rgbd_slam {

/// Row by row.
struct DepthImage {
  const float* data;  ///< [m]; not positive or not finite: unknown
  int width, height;  ///< 2 at least [px]
  std::ptrdiff_t stride;
};

/// Depth at a place of the image: between four pixels of one surface linear, so that a slanted one does not become
/// stairs, else that of the nearest pixel, known or not. NaN outside the image.
float depthAt(const DepthImage& depth, float x, float y);

/// depthAt() of `n` places.
void depthsAt(const DepthImage& depth, const float* x, const float* y, int n, float* out);

}  // namespace rgbd_slam
