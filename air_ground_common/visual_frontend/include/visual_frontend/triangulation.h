// Landmark position from several views, optionally with measured depth.
#pragma once

#include <vector>

#include "visual_frontend/types.h"

namespace visual_frontend {

struct ViewRay {
  Pose T_map_camera = Pose::Identity();
  Eigen::Vector2d normalized = Eigen::Vector2d::Zero();  ///< undistorted x/z, y/z
  double sigma = 1.0 / 500;                              ///< of each normalised coordinate
  double depth = 0;                                      ///< measured z in this camera [m]; 0 = none
  double depth_sigma = 0;                                ///< [m]
  double elongation = 1;                                 ///< of the noise (NormalizedNoise)
};

struct TriangulationSettings {
  double min_parallax = 0.02;  ///< largest angle between two rays [rad]; not needed when a depth is measured
  double max_residual = 3.0;   ///< reprojection (and depth) error of any view, in sigmas
  double min_depth = 0.1;      ///< z in every view [m]
  double max_depth = 100.0;    ///< [m]
  int max_iterations = 10;
};

enum class TriangulationStatus {
  kOk,
  kTooFewViews,
  kLowParallax,
  kBehindCamera,
  kDepthRange,
  kLargeResidual,
  kSingular
};

const char* toString(TriangulationStatus status);

struct TriangulationResult {
  TriangulationStatus status = TriangulationStatus::kTooFewViews;
  Eigen::Vector3d p_map = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< [m^2], cameras taken as exact
  double parallax = 0;                                   ///< largest angle between two rays [rad]
  double max_residual = 0;                               ///< in sigmas
  bool ok() const { return status == TriangulationStatus::kOk; }
};

/// Linear start (midpoint of rays, or measured depth) and Gauss-Newton on reprojection and depth residuals. One view
/// with depth is enough (map points under pure rotation, paper section IV); depth pins the point where parallax is
/// small and fades where parallax is better, each by its sigma.
TriangulationResult triangulate(const std::vector<ViewRay>& views, const TriangulationSettings& settings);

}  // namespace visual_frontend
