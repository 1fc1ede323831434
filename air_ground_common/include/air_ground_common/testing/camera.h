// Cameras for tests and benchmarks.
#pragma once

#include "air_ground_common/camera_model.h"

namespace air_ground_common::testing {

/// 640 x 480 pixels. `pinhole`: fx, fy, cx, cy [px]; `distortion`: k1, k2, p1, p2 of plumb_bob.
inline CameraModel vgaCamera(const Eigen::Vector4d& pinhole, const Eigen::Vector4d& distortion) {
  CameraModel c;
  c.width = 640;
  c.height = 480;
  c.fx = pinhole[0], c.fy = pinhole[1], c.cx = pinhole[2], c.cy = pinhole[3];
  c.k1 = distortion[0], c.k2 = distortion[1], c.p1 = distortion[2], c.p2 = distortion[3];
  return c;
}

}  // namespace air_ground_common::testing
