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

/// How the camera moved while its rolling shutter ran over an image: uniformly, in its own frame at the middle row.
struct RowMotion {
  double readout_time = 0;  ///< row r of h is seen at the image's stamp + (r / h - 0.5) * readout_time [s]
  Eigen::Vector3d angular_rate = Eigen::Vector3d::Zero();  ///< [rad/s]
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();      ///< [m/s]
  double depth = 0;                                        ///< of the scene, along the optical axis [m]; 0: far away
};

class Rectifier {
 public:
  /// `camera`: calibration of the recorded images. Throws std::invalid_argument for a bad calibration or setting.
  explicit Rectifier(const air_ground_common::CameraModel& camera, const RectifierSettings& settings = {});

  /// Pinhole of the images made here: all of its pixels are seen by the recorded image. Of rational_polynomial and
  /// equidistant images it takes the central max_field, with the resolution of their middle.
  const air_ground_common::CameraModel& camera() const { return output_; }
  const air_ground_common::CameraModel& recordedCamera() const { return input_; }

  /// `image`: CV_8UC1 or CV_8UC3 (BGR) of the calibration's size. Throws std::invalid_argument otherwise. Where rows
  /// have times of their own, each is moved to where the camera at the middle row sees it: exactly for the turn, and
  /// for the shift at the given depth.
  Frame rectify(const cv::Mat& image, std::int64_t stamp, const Eigen::Isometry3d& T_map_camera,
                const RowMotion& rows = {}) const;

 private:
  cv::Mat rowMap(const RowMotion& rows) const;

  air_ground_common::CameraModel input_, full_, output_;
  RectifierSettings settings_;
  cv::Mat map1_, map2_;
  cv::Mat exact_map_;  ///< of full_'s pixels to those recorded, CV_32FC2
};

/// Local mean and contrast removed: unaffected by gain, offset and slow shading (vignetting, exposure). CV_8U in and
/// out.
cv::Mat normalizeContrast(const cv::Mat& intensity, const RectifierSettings& settings);

}  // namespace dense_fusion
