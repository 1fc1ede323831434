// Which directions of the pose the matched geometry can fix, and how uncertain the pose is.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "icp_refine/icp_stages.h"

namespace icp_refine {

struct LocalizabilitySettings {
  double strong =
      0.4;  ///< a match counts for a direction when its scaled Jacobian has at least this component along it
  int min_points = 60;       ///< strong matches that a direction needs
  double min_share = 0.015;  ///< and as a share of all matches
  int min_patches = 30;      ///< in at least so many cells of patch_size
  double patch_size = 0.15;  ///< [m]
};

struct Direction {
  Vector6d v = Vector6d::Zero();  ///< unit; translation, then rotation times mean_range
  double eigenvalue = 0;          ///< of the scaled Hessian, as a share of the matches
  int strong_points = 0;
  int strong_patches = 0;
  bool localizable = false;
};

struct Localizability {
  std::array<Direction, 6> directions;  ///< eigenvectors of the scaled Hessian, weakest first
  double mean_range = 0;                ///< scale of rotations: mean distance of the matches from their centre [m]
  bool complete() const;
  /// Directions that are not fixed, for a person: "translation along (1.00 0.02 0.00), rotation about z"; empty when
  /// none.
  std::string describeMissing() const;
};

/// Contributions of the weighted matches to each eigenvector of the Hessian, rotations scaled by the mean range (after
/// Tuna 2024, X-ICP). Only strong contributions count: noise in the normals of a floor adds up to a Hessian that looks
/// sound.
Localizability analyzeLocalizability(const MatchedClouds& clouds, const std::vector<float>& weights,
                                     const Eigen::Vector3d& centre, const LocalizabilitySettings& settings);

struct CovarianceSettings {
  double block_size = 0.5;     ///< residuals inside a block of this edge, facing alike, count as one observation [m]
  double scale_sigma = 0.01;   ///< standard deviation of the relative scale of the two maps
  double noise_floor = 0.004;  ///< independent standard deviation of a block's mean residual, at least [m]
  double map_translation_sigma = 0.02;  ///< distortion of the maps that no residual shows (drift), an axis [m]
  double map_rotation_sigma = 0.006;    ///< likewise [rad]
  double inflation = 1.0;               ///< factor on the standard deviation of the part that comes from the residuals
};

/// Covariance of the step (translation [m], rotation [rad]) about `centre`, reference frame; positive definite.
///   k^2 H^-1 (sum_b g_b g_b^T) H^-1 B/(B-6)  +  scale_sigma^2 b b^T  +  map distortion
///   g_b = sum_{i in b} w_i r_i J_i,   b = H^-1 sum w_i J_i n.(p - c),   k = inflation
/// The first term is the cluster-robust sandwich: correspondence errors are alike within a block, so that blocks, not
/// points, are the sample (sigma^2 (J^T J)^-1 takes all points as independent and is a lower bound; Censi 2007).
/// Directions that `localizability` calls missing get a standard deviation of 1 m (or 1 m / mean range).
Matrix6d estimateCovariance(const MatchedClouds& clouds, const std::vector<float>& weights, const Step& step,
                            const Localizability& localizability, const CovarianceSettings& settings);

}  // namespace icp_refine
