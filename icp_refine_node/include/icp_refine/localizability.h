// Which directions of the alignment the matched geometry can fix, the step along those, and how uncertain the result
// is.
#pragma once

#include <array>
#include <limits>
#include <string>
#include <vector>

#include "air_ground_common/vertical.h"
#include "icp_refine/icp_stages.h"

namespace icp_refine {

using air_ground_common::Vertical;

struct LocalizabilitySettings {
  double strong =
      0.4;  ///< a match counts for a direction when its scaled Jacobian has at least this component along it
  int min_points = 60;       ///< strong matches that a direction needs
  double min_share = 0.015;  ///< and as a share of all matches
  int min_patches = 30;      ///< in at least so many cells of patch_size
  double patch_size = 0.15;  ///< [m]
};

/// What is known of the aerial map's scale before the clouds are compared.
struct ScalePrior {
  enum class Mode {
    kFixed,  ///< held at `mean`; the covariance allows for its uncertainty
    kPrior,  ///< estimated, `mean` and `stddev` being one more measurement
    kFree    ///< estimated from the clouds alone: what they do not fix is degenerate
  };
  Mode mode = Mode::kPrior;
  double mean = 1;       ///< ground-map length per aerial-map length
  double stddev = 0.02;  ///< relative
};

/// What is known of the alignment before the clouds are compared.
struct Priors {
  Priors(const ScalePrior& scale_prior = {}) : scale(scale_prior) {}
  ScalePrior scale;
  Eigen::Vector3d up_reading = Eigen::Vector3d::UnitZ(), up_reference = Eigen::Vector3d::UnitZ();
  /// Of the angle between these two, about each horizontal axis [rad]: finite where both maps hang from gravity.
  double tilt_stddev = std::numeric_limits<double>::infinity();
};

struct Evidence {
  int strong_points = 0;
  int strong_patches = 0;
  bool localizable = false;
};

struct Direction : Evidence {
  Vector6d v = Vector6d::Zero();  ///< unit; translation, then rotation times mean_range
};

struct Localizability {
  std::array<Direction, 6> directions;  ///< of the pose: eigenvectors of the scaled Hessian, weakest first
  Evidence scale;                       ///< what is left for it when the pose has taken what it can explain
  bool needs_scale = false;             ///< no prior holds it
  double mean_range = 0;                ///< scale of rotations: mean distance of the matches from their centre [m]
  bool complete() const;
  /// Directions that are not fixed, for a person: "translation along (1.00 0.02 0.00), rotation about z"; empty when
  /// none.
  std::string describeMissing() const;
};

/// With this many degrees of freedom, the scale follows the clouds; else it is held at the prior's mean (with less than
/// 7, where it is).
bool estimatesScale(const Localizability& localizability, int dof, const ScalePrior& prior);

/// Contributions of the weighted matches to each eigenvector of the pose's Hessian, rotations scaled by the mean range
/// (after Tuna 2024, X-ICP). Only strong contributions count: noise in the normals of a floor adds up to a Hessian that
/// looks sound. A match contributes to the scale by what is left of its derivative after regression on the pose's: on a
/// plane, nothing.
Localizability analyzeLocalizability(const MatchedClouds& clouds, const std::vector<float>& weights,
                                     const NormalEquations& equations, const LocalizabilitySettings& settings,
                                     ScalePrior::Mode mode);

struct CovarianceSettings {
  double block_size = 0.5;     ///< residuals inside a block of this edge, facing alike, count as one observation [m]
  double noise_floor = 0.004;  ///< independent standard deviation of a block's mean residual, at least [m]
  double map_translation_sigma = 0.02;  ///< distortion of the maps that no residual shows (drift), an axis [m]
  double map_rotation_sigma = 0.006;    ///< likewise [rad]
  double map_scale_sigma = 0.003;       ///< likewise, relative
  double inflation = 1.0;               ///< factor on the standard deviation of the part that comes from the residuals
};

/// Scatter of the gradient, the sample being blocks, not points: sum_b g_b g_b^T + noise_floor^2 i_b i_b^T with
/// g_b = sum_{i in b} w_i r_i J_i, i_b = sum w_i J_i, times B/(B-7) for B blocks.
Matrix7d gradientScatter(const MatchedClouds& clouds, const std::vector<float>& weights, const Eigen::Vector3d& centre,
                         const CovarianceSettings& settings);

/// Gauss-Newton step from the alignment T with `dof` degrees of freedom (ErrorMinimizer) under the hard
/// constraint that it has no part along directions of the pose that the geometry does not fix (Tuna 2024). With 7, a
/// scale that the geometry does not fix goes to the prior's mean; else the prior counts as lambda (log(scale / mean))^2
/// with lambda = (k^2 + information map_scale_sigma^2) / stddev^2, k^2 the variance of a unit of weight along the scale
/// that `scatter` shows. So does the tilt up_reference x R up_reading, with 6 or 7.
Vector7d constrainedStep(const NormalEquations& equations, const Localizability& localizability,
                         const Matrix7d& scatter, int dof, const Priors& priors, const Similarity& T,
                         const CovarianceSettings& settings);

/// Covariance of (translation [m], rotation [rad], relative scale) about the equations' centre, reference frame;
/// positive definite. Its first six rows and columns are the pose's, the scale marginalised.
///   k^2 A^-1 S A^-1  +  sum lambda^2 stddev^2 A^-1 e e^T A^-1  +  map distortion,   A = slope H + sum lambda e e^T, k
///   = inflation
/// over the priors, with S the scatter above: the cluster-robust sandwich. Correspondence errors are alike within a
/// block, so that sigma^2 (J^T J)^-1, which takes all points as independent, is a lower bound (Censi 2007). A scale
/// that is held adds stddev^2 b b^T instead, b the alignment's derivative by it. Directions that `localizability` calls
/// missing get a standard deviation of 1 m (or 1 m / mean range).
Matrix7d estimateCovariance(const NormalEquations& equations, const Localizability& localizability,
                            const Matrix7d& scatter, int dof, const Priors& priors, const CovarianceSettings& settings);

}  // namespace icp_refine
