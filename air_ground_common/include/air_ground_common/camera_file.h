// Calibration files, as ROS's camera_calibration writes them.
#pragma once

#include <string>

#include "air_ground_common/camera_model.h"

namespace air_ground_common {

/// Reads image_width, image_height, camera_matrix and, where given, distortion_model (plumb_bob) with
/// distortion_coefficients. Throws std::runtime_error, one line with the path, for a missing file, a missing field or
/// another model.
CameraModel readCameraFile(const std::string& path);

}  // namespace air_ground_common
