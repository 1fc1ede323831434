// Bundle adjustment with Ceres: windowed or full, with optional depth residuals and gravity priors.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "visual_frontend/map.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct BundleSettings {
  double pixel_sigma = 1.0;  ///< of a feature's position [px]
  RobustLoss loss = RobustLoss::kHuber;
  double loss_width = 2.0;        ///< in sigmas
  bool use_depth = true;          ///< depth residuals where observations carry depth
  double depth_loss_width = 2.0;  ///< Cauchy, in sigmas
  bool use_gravity = true;        ///< roll and pitch priors of keyframes that carry up_camera
  int max_iterations = 10;
  double max_seconds = 1.0;  ///< wall clock [s]; a result stopped by it is usable but not reproducible
  int threads = 1;
  double outlier_threshold = 3.0;  ///< sigmas; larger residuals are reported (and disconnected by adjustMap)
  bool remove_outliers = true;     ///< adjustMap: disconnect them
};

/// Plain data: what the solver sees. Poses and points are changed in place.
struct BundleProblem {
  struct Camera {
    Pose T_map_camera = Pose::Identity();
    bool fixed = false;
    std::optional<Eigen::Vector3d> up_camera;  ///< unit
    double up_sigma = 0.02;                    ///< [rad]
  };
  struct Measurement {
    int camera = 0;
    int point = 0;
    Eigen::Vector2d normalized = Eigen::Vector2d::Zero();
    double sigma = 1.0 / 500;
    double depth = 0;  ///< measured z [m]; 0 = none
    double depth_sigma = 0;
    double elongation = 1;  ///< of the noise (NormalizedNoise)
  };
  /// Relative pose prior, for example from an IMU or odometry.
  struct RelativePrior {
    int camera_a = 0, camera_b = 0;
    Pose T_a_b = Pose::Identity();
    double rotation_sigma = 0.01;   ///< [rad]; <= 0 leaves the rotation out
    double translation_sigma = -1;  ///< [m]; <= 0 leaves the translation out
  };
  std::vector<Camera> cameras;
  std::vector<Eigen::Vector3d> points;
  std::vector<unsigned char> point_fixed;  ///< empty = none
  std::vector<Measurement> measurements;
  std::vector<RelativePrior> priors;
};

struct BundleResult {
  bool usable = false;
  std::string message;  ///< the solver's own words
  double initial_cost = 0, final_cost = 0;
  int iterations = 0;
  double seconds = 0;
  double rms = 0;             ///< reprojection error of the inliers per coordinate, in sigmas
  std::vector<int> outliers;  ///< indices of measurements beyond outlier_threshold, ascending
};

/// Throws std::invalid_argument for indices out of range or values that are not finite.
BundleResult solveBundle(BundleProblem& problem, const BundleSettings& settings);

/// Optimises `free` keyframes and the landmarks they see; `fixed` keyframes also constrain those landmarks. Keyframes
/// in neither list are not touched and not used. At least one keyframe should be fixed (two for a monocular map), else
/// the first is held. Disconnects outliers; landmarks left with one observation without depth are removed.
BundleResult adjustMap(Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                       const std::vector<KeyframeId>& fixed, const BundleSettings& settings);

/// adjustMap over all keyframes; `fixed` as there (empty: the oldest is held).
BundleResult adjustFullMap(Map& map, const CameraModel& camera, const std::vector<KeyframeId>& fixed,
                           const BundleSettings& settings);

}  // namespace visual_frontend
