// Pinhole camera with radial-tangential distortion (ROS "plumb_bob", OpenCV's order k1 k2 p1 p2 k3).
// Pixel (0, 0) is the centre of the top-left pixel, as in ROS and OpenCV.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <optional>

namespace air_ground_common {

struct CameraModel {
  int width = 0;          ///< [px]
  int height = 0;         ///< [px]
  double fx = 0, fy = 0;  ///< focal lengths [px]
  double cx = 0, cy = 0;  ///< principal point [px]
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;

  /// Throws std::invalid_argument, naming the field, when a size or focal length is not positive or a number not
  /// finite.
  void validate() const;

  bool hasDistortion() const { return k1 != 0 || k2 != 0 || p1 != 0 || p2 != 0 || k3 != 0; }
  Eigen::Matrix3d K() const;
  cv::Mat cvK() const;           ///< 3x3 CV_64F
  cv::Mat cvDistortion() const;  ///< 1x5 CV_64F

  /// Distorts normalised image coordinates (x/z, y/z).
  Eigen::Vector2d distort(const Eigen::Vector2d& normalized) const;

  /// Pixel of a point in the optical frame [m]; empty when the point is not in front of the camera (z < 1e-6).
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera) const;

  /// As project, with the 2x3 Jacobian d pixel / d p_camera.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera, Eigen::Matrix<double, 2, 3>* jacobian) const;

  /// Normalised coordinates (x/z, y/z) of a pixel: inverts the distortion by Newton iterations.
  Eigen::Vector2d unproject(const Eigen::Vector2d& pixel) const;

  /// Unit-norm ray through a pixel, in the optical frame.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

  /// True when the pixel lies at least `border` pixels inside the image.
  bool contains(const Eigen::Vector2d& pixel, double border = 0) const;

  /// The same camera for an image resized by `factor` (keeps pixel-centre conventions).
  CameraModel scaled(double factor) const;

  /// Pinhole without distortion, same size and K.
  CameraModel undistorted() const;
};

}  // namespace air_ground_common
