// Depth images as the colour camera would see them, for sensors whose driver does not register them.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"

namespace rgbd_slam {

/// Depth of the colour camera at another resolution than its images: each pixel as at its centre. Empty where the
/// proportions differ by more than 1 %.
std::optional<cv::Mat> depthAtSize(const cv::Mat& depth, int width, int height);

/// Whether the depth camera's calibration, brought to the size of the colour images, is the colour camera's: within 3 %
/// of the focal lengths and 2 % of the size. Else its depth images are hardly registered to it.
bool seesAlike(const air_ground_common::CameraModel& depth_camera, const air_ground_common::CameraModel& colour_camera);

class DepthRegistration {
 public:
  /// `T_colour_depth`: pose of the depth camera's optical frame in the colour camera's. Any distortion model.
  DepthRegistration(const air_ground_common::CameraModel& depth_camera,
                    const air_ground_common::CameraModel& colour_camera, const air_ground_common::Pose& T_colour_depth);

  /// Depth [m] along the colour camera's axis, CV_32F of the colour camera's size: the nearest surface in each pixel,
  /// NaN where there is none. `depth`: CV_32F of the depth camera's size [m], NaN or <= 0 unknown; throws
  /// std::invalid_argument for another size or type. A depth pixel that covers several colour pixels fills them.
  cv::Mat operator()(const cv::Mat& depth) const;

 private:
  air_ground_common::CameraModel depth_camera_, colour_camera_;
  Eigen::Vector3f p_colour_depth_;
  std::vector<Eigen::Vector3f> rays_;  ///< of the depth camera's pixels with z = 1, in the colour camera's axes
  int width_, height_;                 ///< of a depth pixel in colour pixels, rounded up
};

}  // namespace rgbd_slam
