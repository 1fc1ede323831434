// Calibration files, as ROS's camera_calibration writes them.
#pragma once

#include <string>

#include "air_ground_common/camera_model.h"

namespace air_ground_common {

/// Reads image_width, image_height, camera_matrix and, where given, distortion_model (see CameraModel::setDistortion;
/// plumb_bob without) with distortion_coefficients: ROS's files and OpenCV's, with their flag fisheye_model. Throws
/// std::runtime_error, one line with the path, for a missing file, a missing field or another model.
CameraModel readCameraFile(const std::string& path);

/// The text of such a file.
std::string cameraFileText(const CameraModel& camera, const std::string& name);

}  // namespace air_ground_common
