// A depth map with the pinhole camera and the pose it was computed for.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <opencv2/core/mat.hpp>

#include "air_ground_common/camera_model.h"

namespace dense_fusion {

struct DepthMap {
  std::int64_t stamp = 0;                                          ///< time of the reference image [ns]
  air_ground_common::CameraModel camera;                           ///< undistorted pinhole of all three images
  Eigen::Isometry3d T_map_camera = Eigen::Isometry3d::Identity();  ///< reference pose
  cv::Mat depth;       ///< CV_32F, z along the optical axis [m]; NaN where unknown
  cv::Mat confidence;  ///< CV_32F in [0, 1]; 0 where depth is NaN
  cv::Mat intensity;   ///< CV_8U, reference image
  int frames = 0;      ///< images behind the estimate, the reference included
};

}  // namespace dense_fusion
