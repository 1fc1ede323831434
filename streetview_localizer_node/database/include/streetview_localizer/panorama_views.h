// Cuts an equirectangular panorama into overlapping perspective views.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct PanoramaViewSettings {
  int width = 640;                         ///< of a view [px]
  int height = 640;                        ///< [px]
  double horizontal_fov = 1.3963;          ///< of a view [rad] (80 degrees)
  double yaw_step = 0.7854;                ///< between views; rounded so that a whole number fits the circle [rad]
  std::vector<double> pitches = {0.2618};  ///< of the optical axes, up positive: facades stand above the camera [rad]
};

/// Unit direction, in the panorama's body frame (x to the image's centre, y left, z up), of pixel (u, v); (0, 0) is the
/// centre of the top-left pixel. Columns run clockwise seen from above: azimuth = ((u + 1/2) / W - 1/2) 2 pi to the
/// right of x, elevation = (1/2 - (v + 1/2) / H) pi.
Eigen::Vector3d panoramaRay(const cv::Size& size, const Eigen::Vector2d& pixel);

/// Inverse of panoramaRay for a direction of any length; u in [-1/2, W - 1/2).
Eigen::Vector2d panoramaPixel(const cv::Size& size, const Eigen::Vector3d& direction);

/// Views with camera, T_world_camera and image, `id` counted from 0; `panorama` 0. Pixels are averaged over their
/// footprint where the panorama is finer than the view. Throws std::invalid_argument for an image that is empty or not
/// twice as wide as high (2 % of tolerance).
std::vector<View> cutPanorama(const cv::Mat& image, const air_ground_common::Pose& T_world_panorama,
                              const PanoramaViewSettings& settings = {});

}  // namespace streetview_localizer
