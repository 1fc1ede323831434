// Central camera with the distortion models of ROS's camera_info: plumb_bob, rational_polynomial, equidistant.
// Pixel (0, 0) is the centre of the top-left pixel, as in ROS and OpenCV. "Normalised" coordinates are (x/z, y/z).
#pragma once

#include <Eigen/Core>
#include <limits>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

namespace air_ground_common {

enum class DistortionModel {
  kPlumbBob,            ///< Brown: radial polynomial k1 k2 k3, tangential p1 p2
  kRationalPolynomial,  ///< (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), p1 p2, thin prism s1..s4
  kEquidistant          ///< Kannala and Brandt, PAMI 2006: theta (1 + k1 theta^2 + ... + k4 theta^8), a fisheye's
};

/// Noise of a pixel's position on the normalised plane: `sigma` its geometric mean over directions, `elongation` the
/// standard deviation away from the optical axis over that across. 1 where the lens is close to a pinhole.
struct NormalizedNoise {
  double sigma = 0;
  double elongation = 1;
};

struct CameraModel {
  int width = 0;          ///< [px]
  int height = 0;         ///< [px]
  double fx = 0, fy = 0;  ///< focal lengths [px]
  double cx = 0, cy = 0;  ///< principal point [px]
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;
  double k4 = 0, k5 = 0, k6 = 0;
  double s1 = 0, s2 = 0, s3 = 0, s4 = 0;
  DistortionModel model = DistortionModel::kPlumbBob;
  /// Largest length of normalised coordinates that the model describes: where it folds back on itself, and 80 degrees
  /// off the axis with the wide-angle models. setDistortion finds it.
  double max_radius = std::numeric_limits<double>::infinity();

  /// Sets model and coefficients as camera_info and calibration files hold them: `name` plumb_bob (radtan),
  /// rational_polynomial, equidistant (fisheye) or, without coefficients, none (pinhole); those left out are zero.
  /// Throws std::invalid_argument, naming the known models, for others and for coefficients that a model has not.
  void setDistortion(const std::string& name, const std::vector<double>& coefficients);
  std::string distortionName() const;                                         ///< as camera_info names it
  std::vector<double> distortionCoefficients() const;                         ///< 5, 8 (12 with thin prism) or 4
  static constexpr double kMaxHalfAngle = 80 * 3.14159265358979323846 / 180;  ///< of the wide-angle models [rad]

  /// Throws std::invalid_argument, naming the field, when a size or focal length is not positive or a number not
  /// finite.
  void validate() const;

  bool hasDistortion() const;
  Eigen::Matrix3d K() const;
  cv::Mat cvK() const;           ///< 3x3 CV_64F
  cv::Mat cvDistortion() const;  ///< 1xn CV_64F: for cv::fisheye with kEquidistant, for OpenCV's other functions else

  /// Distorts normalised image coordinates: pixel = f * distorted + c.
  Eigen::Vector2d distort(const Eigen::Vector2d& normalized) const;

  /// Pixel of a point in the optical frame [m]; empty when the point is not in front of the camera (z < 1e-6) or beyond
  /// what the model describes.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera) const;

  /// As project, with the 2x3 Jacobian d pixel / d p_camera.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera, Eigen::Matrix<double, 2, 3>* jacobian) const;

  /// Normalised coordinates of a pixel: inverts the distortion by Newton iterations. Not finite where the model sees
  /// nothing: outside the image circle of a fisheye, or beyond where a polynomial folds back.
  Eigen::Vector2d unproject(const Eigen::Vector2d& pixel) const;

  /// Unit-norm ray through a pixel, in the optical frame; not finite where unproject is not.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

  /// Noise of `pixel_sigma` [px] at a direction. Uniform for plumb_bob; the wide-angle models stretch it towards the
  /// rim (by 1/cos^2 of the angle off the axis, radially).
  NormalizedNoise normalizedNoise(const Eigen::Vector2d& normalized, double pixel_sigma) const;

  /// True when the pixel lies at least `border` pixels inside the image and inside the circle that the model describes:
  /// its ray is then finite.
  bool contains(const Eigen::Vector2d& pixel, double border = 0) const;

  /// The same camera for an image resized by `factor` (keeps pixel-centre conventions).
  CameraModel scaled(double factor) const;

  /// The same camera for a window of the image whose pixels are then averaged in blocks (camera_info's roi and
  /// binning). Throws std::invalid_argument when the window is not inside the image.
  CameraModel window(int x, int y, int window_width, int window_height, int binning_x, int binning_y) const;

  /// Pinhole without distortion, same size and K.
  CameraModel undistorted() const;
};

}  // namespace air_ground_common
