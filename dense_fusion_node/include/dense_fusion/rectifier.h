// Turns recorded images into the reduced, undistorted, exposure-normalised ones that the plane sweep compares.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <opencv2/core/mat.hpp>

#include "air_ground_common/camera_model.h"

namespace dense_fusion {

struct RectifierSettings {
  double scale = 0.5;            ///< size of the undistorted image relative to the recorded one, 1 or 1/n
  int normalization_radius = 8;  ///< half width of the window of local mean and contrast [px of the reduced image]
  double contrast_floor = 4.0;  ///< added to the local standard deviation, so that noise is not amplified [grey levels]
  double contrast_gain = 40.0;  ///< grey levels per local standard deviation after normalisation
  double max_field = 1.745;     ///< across and down, of the view made of a wide-angle image [rad]
};

/// One image ready for the plane sweep.
struct Frame {
  std::int64_t stamp = 0;  ///< [ns]
  Eigen::Isometry3d T_map_camera = Eigen::Isometry3d::Identity();
  cv::Mat intensity;   ///< CV_8U, undistorted
  cv::Mat normalized;  ///< CV_8U, 128 + gain * (intensity - local mean) / (local deviation + floor)
};

class Rectifier {
 public:
  /// `camera`: calibration of the recorded images. Throws std::invalid_argument for a bad calibration or setting.
  explicit Rectifier(const air_ground_common::CameraModel& camera, const RectifierSettings& settings = {});

  /// Pinhole of the images made here: all of its pixels are seen by the recorded image. Of rational_polynomial and
  /// equidistant images it takes the central max_field, with the resolution of their middle.
  const air_ground_common::CameraModel& camera() const { return output_; }
  const air_ground_common::CameraModel& recordedCamera() const { return input_; }

  /// `image`: CV_8UC1 or CV_8UC3 (BGR) of the calibration's size. Throws std::invalid_argument otherwise.
  Frame rectify(const cv::Mat& image, std::int64_t stamp, const Eigen::Isometry3d& T_map_camera) const;

 private:
  air_ground_common::CameraModel input_, output_;
  RectifierSettings settings_;
  cv::Mat map1_, map2_;
};

/// Local mean and contrast removed: unaffected by gain, offset and slow shading (vignetting, exposure). CV_8U in and
/// out.
cv::Mat normalizeContrast(const cv::Mat& intensity, const RectifierSettings& settings);

}  // namespace dense_fusion
