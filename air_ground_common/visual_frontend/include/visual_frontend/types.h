// Shared by the visual front end. Frames: T_map_camera maps points of the optical camera frame (x right, y down, z
// forward) to the map. "Normalised" image coordinates are undistorted (x/z, y/z); CameraModel::normalizedNoise turns
// pixels of noise into their sigma, and into the elongation away from the optical axis that wide-angle lenses give it.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"

namespace visual_frontend {

using air_ground_common::CameraModel;
using air_ground_common::Matrix6d;
using air_ground_common::NormalizedNoise;
using air_ground_common::Pose;
using air_ground_common::Vector6d;

using TrackId = std::int64_t;
using LandmarkId = std::int64_t;
using KeyframeId = int;

constexpr TrackId kNoTrack = -1;
constexpr LandmarkId kNoLandmark = -1;
constexpr KeyframeId kNoKeyframe = -1;

/// Square root of the information of normalised coordinates: multiplies a difference to give it in sigmas.
inline Eigen::Matrix2d whitening(const Eigen::Vector2d& normalized, const NormalizedNoise& noise) {
  Eigen::Matrix2d W = Eigen::Matrix2d::Identity() / noise.sigma;
  const double r2 = normalized.squaredNorm();
  if (noise.elongation == 1 || r2 == 0) return W;
  const double stretch = std::sqrt(noise.elongation);
  return stretch * W + (1 / stretch - stretch) / (noise.sigma * r2) * normalized * normalized.transpose();
}

/// Squared length of such a difference in sigmas.
inline double squaredSigmas(const Eigen::Vector2d& difference, const Eigen::Vector2d& normalized,
                            const NormalizedNoise& noise) {
  double squared = difference.squaredNorm();
  const double r2 = normalized.squaredNorm();
  if (noise.elongation != 1 && r2 > 0) {
    const double along = difference.dot(normalized), radial = along * along / r2;
    squared = radial / noise.elongation + (squared - radial) * noise.elongation;
  }
  return squared / (noise.sigma * noise.sigma);
}

}  // namespace visual_frontend
