// What the registration sees in a panorama, after it has been turned level: the sky line, lines, vertical boundaries.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

namespace streetview_localizer::registration {

/// Column and row of a direction (any length) in an equirectangular image, and back. (0, 0) is the top-left pixel's
/// centre.
inline Eigen::Vector2d pixelOf(const Eigen::Vector3d& direction, int width, int height) {
  const double azimuth = std::atan2(direction.y(), direction.x());
  const double elevation = std::atan2(direction.z(), std::hypot(direction.x(), direction.y()));
  return {(0.5 - azimuth / (2 * M_PI)) * width - 0.5, (0.5 - elevation / M_PI) * height - 0.5};
}
inline Eigen::Vector3d rayOf(double u, double v, int width, int height) {
  const double azimuth = (0.5 - (u + 0.5) / width) * 2 * M_PI, elevation = (0.5 - (v + 0.5) / height) * M_PI;
  return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
}

/// An equirectangular image in a frame turned by R_body_level: level(ray) = body(R_body_level * ray).
cv::Mat turnPanorama(const cv::Mat& image, const Eigen::Matrix3d& R_body_level, int interpolation);

/// A straight edge: an arc of the great circle in the plane through the centre with this unit normal.
struct Segment {
  Eigen::Vector3d normal;
  Eigen::Vector3d middle;  ///< unit ray
  double length = 0;       ///< [rad]
  double stddev = 0;       ///< of the normal's turn about the middle ray [rad]
};

/// Straight edges within `max_elevation` of the horizon: maxima of the gradient, linked, split where they bend, and
/// fitted.
std::vector<Segment> findSegments(const cv::Mat& bgr, const cv::Mat& mask, double max_elevation);

/// Direction that most near-vertical segments share, in the image's frame, near +z; `stddev` of either tilt [rad], as
/// large as `start_stddev` when the image has too few vertical lines.
Eigen::Vector3d verticalDirection(const std::vector<Segment>& segments, double start_stddev, double* stddev);

/// How far a vertical line at a column is a boundary between two surfaces: strength in [0, 1] is the share of the rows
/// whose colour changes there, with one sign.
class VerticalEvidence {
 public:
  VerticalEvidence(const cv::Mat& bgr, const cv::Mat& mask);
  /// Of rows [top, bottom) between the columns before and at `column`: at column - 1/2. Wraps around.
  float strength(int column, int top, int bottom) const;
  int width() const { return width_; }
  int height() const { return height_; }

 private:
  int width_ = 0, height_ = 0;
  std::vector<float> sums_[3];  ///< per channel, (height + 1) x width: running sums down the columns
};

}  // namespace streetview_localizer::registration
