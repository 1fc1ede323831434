// Camera pose from matches with known 3D points (paper B, II.C): P3P in RANSAC, EPnP, Levenberg-Marquardt; the second
// pose that a nearly planar facade admits; the best competitor among the matches left over; covariance with the
// database's errors.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "streetview_localizer/types.h"

namespace streetview_localizer {

using air_ground_common::CameraModel;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;

/// Where the 3D points come from: cast from one panorama onto the city model. Standard deviations are of one axis.
struct PointSource {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< of the panorama, or photograph, in world [m]
  double position_stddev = 0.12;                       ///< of its registered position [m] (paper B, II.B)
  double orientation_stddev = 0.0083;                  ///< of its registered orientation [rad], 0.476 degrees
  double model_lateral_stddev = 0.1;  ///< of a wall along its normal, common to all points of that wall [m]
  double model_relief_stddev = 0.1;   ///< of a wall's relief that the model lacks, common to patches of 2 m [m]
  double model_height_stddev = 0.5;   ///< of the model with all that is registered to it [m]
};

/// What is known beforehand. Gravity enters the estimate. The predicted pose does not, since a filter fuses the result
/// with it: it only helps to choose between the two poses of a plane, and has no say where it fits neither.
struct PosePrior {
  std::optional<Eigen::Vector3d> up_camera;    ///< against gravity, in the camera's optical frame, any length
  double up_stddev = 0.02;                     ///< [rad]
  std::optional<Pose> T_world_camera;          ///< predicted
  Matrix6d covariance = Matrix6d::Identity();  ///< of the prediction, in the order of PoseResult::covariance
  double min_z = -std::numeric_limits<double>::infinity();  ///< the camera is above: the ground there [m]
  double max_z = std::numeric_limits<double>::infinity();   ///< and below [m]
  bool not_mirrored = false;  ///< what turns the images is what turns a gyro: nothing flips them
};

struct PoseSettings {
  double inlier_threshold = 5.0;  ///< reprojection error [px]
  double pixel_stddev = 1.0;      ///< smallest noise of a match that is believed [px]
  int max_iterations = 1000;      ///< of RANSAC
  double confidence = 0.999;      ///< probability of one clean sample, at which RANSAC ends
  int min_inliers = 8;
  double max_range = 20.0;      ///< Monte Carlo: camera farther from the panorama than this is implausible (III.C) [m]
  int monte_carlo_samples = 0;  ///< of five matches each; the paper's covariance takes 1000; 0 = off
  bool find_competitor = true;  ///< look for another pose among the matches left over
  unsigned seed = 1;

  /// Throws std::invalid_argument, naming the field, when a value cannot work.
  void validate() const;
};

/// One pose and how the matches agree with it.
struct PoseHypothesis {
  Pose T_world_camera = Pose::Identity();
  std::vector<int> inliers;  ///< indices of correspondences, ascending
  double rms = 0;            ///< reprojection error of the inliers, root mean square of its length [px]
  double cost = 0;           ///< sum over all matches of min(error^2, threshold^2) [px^2]
};

struct PoseResult : PoseHypothesis {
  bool success = false;
  std::string reason;  ///< why there is no pose; empty on success

  /// Of (x, y, z, rotX, rotY, rotZ) in world at the camera's optical centre [m, rad]: R_true = exp(rot) R. Image noise
  /// as measured on the inliers, plus what all points share: errors of the panorama's pose, of each wall and of the
  /// model's height.
  Matrix6d covariance = Matrix6d::Zero();
  Matrix6d image_covariance = Matrix6d::Zero();  ///< the part due to image noise alone
  double noise = 0;                              ///< of a match, one axis, estimated [px]
  /// By how much each correspondence's point was moved with the estimated offset of its wall, in world [m]; empty: none
  /// was. Inliers, rms and cost are those of the moved points.
  std::vector<Eigen::Vector3d> wall_shifts;

  /// The other pose that a plane admits, refined on all matches; empty when there is none.
  std::optional<PoseHypothesis> alternative;
  /// Log-likelihood ratio of this pose over `alternative`: reprojection, gravity, side of the walls, height,
  /// prediction. Infinite without alternative.
  double alternative_margin = std::numeric_limits<double>::infinity();

  /// The best pose from matches that contradict this one, as a row of equal windows gives; empty when there is none.
  /// Its inliers may be matches that a filter dropped.
  std::optional<PoseHypothesis> competitor;

  /// Paper's covariance (III.C): scatter of P3P over samples of five matches; empty unless asked for and enough were
  /// plausible.
  std::optional<Matrix6d> monte_carlo_covariance;
  int monte_carlo_plausible = 0;  ///< samples that gave a pose within max_range
};

/// Never throws for bad matches: those that are not finite are left out, and what cannot give a pose (too few, on a
/// line, no consensus) is said in `reason`. Throws std::invalid_argument for a camera, setting, source or prior that
/// cannot be. `correspondences` may hold wrong matches; better `quality` is sampled first (PROSAC, Chum and Matas
/// 2005). Those from `first_dropped` on were dropped by a filter such as k-VLD: only the competitor is sought among
/// them, too.
PoseResult estimatePose(const std::vector<Correspondence>& correspondences, const CameraModel& camera,
                        const PointSource& source, const PosePrior& prior, const PoseSettings& settings,
                        std::size_t first_dropped = std::numeric_limits<std::size_t>::max());

/// The correspondences of `result`, or the first of them, with their points moved by its wall_shifts.
std::vector<Correspondence> onMovedWalls(std::vector<Correspondence> correspondences, const PoseResult& result);

/// How matches agree with a pose: inliers within settings.inlier_threshold, their rms, and cost.
PoseHypothesis scorePose(const Pose& T_world_camera, const std::vector<Correspondence>& correspondences,
                         const CameraModel& camera, const PoseSettings& settings);

}  // namespace streetview_localizer
