// Pinhole views of wide-angle images, for what needs straight lines.
#pragma once

#include <opencv2/core/mat.hpp>

#include "air_ground_common/camera_model.h"

namespace air_ground_common {

/// Pinhole whose pixels `camera` sees, all of them: the largest rectangle about the optical axis, at most `max_field`
/// [rad] across and down, with the resolution that the camera has on the axis. Its width and height are multiples of 8.
/// Throws std::invalid_argument when less than 32 pixels are left, or more than four times the camera's own would be.
CameraModel centralPinhole(const CameraModel& camera, double max_field);

/// Where `camera` saw each pixel of `view`, a camera at the same place and attitude: CV_32FC2, for cv::remap. What it
/// did not see lies at (-1, -1).
cv::Mat rectificationMap(const CameraModel& camera, const CameraModel& view);

}  // namespace air_ground_common
