// Noise of a structured-light depth camera, and reading depth at image features.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>

namespace rgbd_slam {

struct DepthModel {
  double sigma_base = 0.0015;       ///< noise at short range [m]
  double sigma_quadratic = 0.0022;  ///< growth with z^2 [1/m]; Khoshelham and Elberink 2012: about 0.0014 to 0.003
  double min_range = 0.4;           ///< nearest depth that is used [m]
  double max_range = 4.5;           ///< farthest depth that is used for landmarks [m]

  double sigma(double z) const { return sigma_base + sigma_quadratic * z * z; }
  /// Throws std::invalid_argument, naming the field.
  void validate() const;
};

/// Of a pixel of a depth image [m].
inline bool isKnown(float z) { return std::isfinite(z) && z > 0; }

/// Depth [m] at a pixel of a CV_32F image (NaN or <= 0 = unknown): median of the 3x3 neighbourhood. Empty where fewer
/// than five of the nine are known, outside the range, or at a depth edge (spread beyond 4 sigma plus 2 % of z).
std::optional<double> sampleDepth(const cv::Mat& depth, const Eigen::Vector2d& pixel, const DepthModel& model);

/// Of a depth image [m], by every seventh pixel; NaN where too little is known.
double medianDepth(const cv::Mat& depth);

/// What is wrong with the unit of a depth image, by its median [m]: no depth camera sees a scene 100 m away, or 3 cm.
/// Empty when nothing is, or too little is known (NaN).
std::string unitProblem(double median_depth);

}  // namespace rgbd_slam
