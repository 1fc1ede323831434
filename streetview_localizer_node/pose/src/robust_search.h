// Matches prepared for fast scoring, and the sampling that finds a pose which many of them support.
#pragma once

#include <optional>
#include <vector>

#include "streetview_localizer/pose_estimation.h"
#include "visual_frontend/pose_solver.h"

namespace streetview_localizer::detail {

/// Finite matches as normalised coordinates in units of pixels to first order, in plain arrays.
struct Matches {
  std::vector<visual_frontend::PoseCorrespondence> points;  ///< sigma: one pixel
  std::vector<int> index;                                   ///< of the Correspondence
  std::vector<Eigen::Vector3d> normals;                     ///< of the wall in world; zero if unknown
  std::vector<Eigen::Vector3d> centres;  ///< of the views that cast the points; not finite: the source's
  std::vector<int> wall;                 ///< matches on one plane of the model share it; -1 without normal
  std::vector<double> quality;
  std::vector<float> x, y, z, u, v, weight;  ///< relative to `origin`; weight = 1 / sigma
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::size_t size() const { return points.size(); }
  const Eigen::Vector3d& centreOf(std::size_t i, const PointSource& source) const {
    return centres[i].allFinite() ? centres[i] : source.position;
  }
};

Matches prepare(const std::vector<Correspondence>& correspondences, const CameraModel& camera);

/// Sum over the matches of min(error^2, threshold^2) [px^2]; ends early once above `limit`.
double truncatedCost(const Matches& matches, const Pose& T_world_camera, double threshold, double limit);

/// Squared reprojection error [px^2]; huge behind the camera.
double squaredError(const Matches& matches, std::size_t i, const Pose& T_camera_world);

/// Positions in `matches` (not of the Correspondence) with an error below `threshold` [px].
std::vector<int> inliersOf(const Matches& matches, const Pose& T_world_camera, double threshold);

/// The matches at these positions.
Matches subset(const Matches& matches, const std::vector<int>& positions);

/// Share of the matches at `positions` with a known normal whose wall faces a camera at `centre`; 1 when none is known.
double facingShare(const Matches& matches, const std::vector<int>& positions, const Eigen::Vector3d& centre);

/// Angle between the known and the hypothesis's direction up [rad]; 0 when unknown.
double tilt(const PosePrior& prior, const Pose& T_world_camera);

/// Tilt beyond which a sample is none: three noisy points fix gravity only roughly [rad].
double mostTilt(const PosePrior& prior);

/// Levenberg-Marquardt on the matches at `positions`, robust with the given noise [px], gravity as prior. Empty when it
/// fails.
std::optional<Pose> refine(const Matches& matches, const std::vector<int>& positions, const Pose& initial, double noise,
                           const PosePrior& prior, int iterations = 15);

/// Refines and counts again, up to `rounds` times, from the matches at `positions`; empty when too few support it. Only
/// the first round goes by these: a pose of three noisy points has but some of its matches, which a better one gains.
std::optional<Pose> converge(const Matches& matches, std::vector<int> positions, const Pose& initial, double noise,
                             const PosePrior& prior, const PoseSettings& settings, int rounds = 3);

/// PROSAC over P3P with local optimisation. Samples must see walls from outside, keep the height and roughly gravity.
std::optional<Pose> search(const Matches& matches, const PosePrior& prior, const PoseSettings& settings,
                           int max_iterations);

}  // namespace streetview_localizer::detail
