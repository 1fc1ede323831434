// The images that localize_images and publish_images work on, with the calibration of each.
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"

namespace streetview_localizer {

/// Calibrations of single images: lines of `image fx fy cx cy [k1 k2 p1 p2 k3]`, separated by blanks or commas; '#' and
/// a header line that begins with `image` are skipped. Width and height stay 0. A line with other columns, such as
/// poses, is an error: what is to be found out must not be in the input. Throws std::runtime_error with file and line.
std::map<std::string, air_ground_common::CameraModel> readCameraList(const std::string& path);

/// Directions against gravity in the optical frame: lines of `image x y z`, as above.
std::map<std::string, Eigen::Vector3d> readUpList(const std::string& path);

/// Names of the images (jpg, jpeg, png, any case) in a folder, sorted. Throws std::runtime_error for a missing folder,
/// or one without images.
std::vector<std::string> listImages(const std::string& folder);

/// Those of them that have a calibration: a list of calibrations is a choice of images too. Throws std::runtime_error
/// where that leaves none; `list` is the name of the calibrations' file.
std::vector<std::string> listCalibratedImages(const std::string& folder,
                                              const std::map<std::string, air_ground_common::CameraModel>& cameras,
                                              const std::string& list);

}  // namespace streetview_localizer
