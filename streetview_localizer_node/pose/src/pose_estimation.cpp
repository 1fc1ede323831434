#include "streetview_localizer/pose_estimation.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <opengv/absolute_pose/CentralAbsoluteAdapter.hpp>
#include <opengv/absolute_pose/methods.hpp>
#include <stdexcept>

#include "planar_alternative.h"
#include "pose_covariance.h"
#include "robust_search.h"
#include "wall_offsets.h"

namespace streetview_localizer {

using detail::Matches;

namespace {

void require(bool good, const std::string& what) {
  if (!good) throw std::invalid_argument(what);
}

void validate(const PointSource& source) {
  require(source.position.allFinite(), "point source: the position is not finite");
  for (const double s :
       {source.position_stddev, source.orientation_stddev, source.model_lateral_stddev, source.model_height_stddev}) {
    require(std::isfinite(s) && s >= 0, "point source: a standard deviation is negative or not finite");
  }
}

void validate(const PosePrior& prior) {
  if (prior.up_camera) {
    require(prior.up_camera->allFinite() && prior.up_camera->norm() > 1e-6,
            "pose prior: up_camera is zero or not finite");
    require(prior.up_stddev > 0 && std::isfinite(prior.up_stddev), "pose prior: up_stddev must be positive");
  }
  if (prior.T_world_camera) {
    require(air_ground_common::isValid(*prior.T_world_camera),
            "pose prior: the predicted pose is not a rigid transform");
    require(prior.covariance.allFinite() && Eigen::LLT<Matrix6d>(prior.covariance).info() == Eigen::Success,
            "pose prior: the covariance is not positive definite");
  }
  require(!(prior.min_z >= prior.max_z), "pose prior: min_z is not below max_z");
}

/// EPnP (Lepetit, Moreno-Noguer, Fua 2009) on the inliers. Empty for points on a plane, on which OpenGV's crashes;
/// theirs is IPPE, see planarAlternatives.
std::optional<Pose> epnp(const Matches& m, const std::vector<int>& inliers) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int i : inliers) mean += m.points[i].p_map / static_cast<double>(inliers.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int i : inliers) scatter += (m.points[i].p_map - mean) * (m.points[i].p_map - mean).transpose();
  const Eigen::Vector3d values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter, Eigen::EigenvaluesOnly).eigenvalues();
  if (!(values[0] > 1e-4 * values[1])) return std::nullopt;
  opengv::bearingVectors_t rays;
  opengv::points_t points;
  for (const int i : inliers) {
    rays.push_back(m.points[i].normalized.homogeneous().normalized());
    points.push_back(m.points[i].p_map - m.origin);
  }
  opengv::absolute_pose::CentralAbsoluteAdapter adapter(rays, points);
  const opengv::transformation_t found = opengv::absolute_pose::epnp(adapter);
  Pose T = Pose::Identity();
  T.linear() = found.leftCols<3>();
  T.translation() = found.col(3) + m.origin;
  if (!air_ground_common::isValid(T)) return std::nullopt;
  return T;
}

PoseHypothesis hypothesis(const Matches& m, const Pose& T, const std::vector<Correspondence>& correspondences,
                          const CameraModel& camera, const PoseSettings& settings) {
  PoseHypothesis h;
  h.T_world_camera = T;
  h.cost = detail::truncatedCost(m, T, settings.inlier_threshold, std::numeric_limits<double>::infinity());
  const Pose T_camera_world = T.inverse();
  double sum = 0;
  for (const int i : detail::inliersOf(m, T, settings.inlier_threshold)) {
    const Correspondence& c = correspondences[m.index[i]];
    const auto pixel = camera.project(T_camera_world * m.points[i].p_map);
    if (!pixel) continue;
    sum += (*pixel - c.pixel).squaredNorm();
    h.inliers.push_back(m.index[i]);
  }
  h.rms = h.inliers.empty() ? 0 : std::sqrt(sum / static_cast<double>(h.inliers.size()));
  return h;
}

/// Noise of a match, one axis, from the median error: a Rayleigh distribution's is 1.1774 sigma.
double noiseOf(const Matches& m, const std::vector<int>& inliers, const Pose& T, const PoseSettings& settings) {
  const Pose inverse = T.inverse();
  std::vector<double> errors;
  for (const int i : inliers) errors.push_back(std::sqrt(detail::squaredError(m, i, inverse)));
  std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
  return std::max(settings.pixel_stddev, errors[errors.size() / 2] / 1.1774);
}

/// A pose from matches that contradict `pose`: those it does not explain, by a wide margin. It must not explain the
/// inliers.
std::optional<Pose> findCompetitor(const Matches& m, const Pose& pose, const std::vector<int>& inliers,
                                   const PosePrior& prior, const PoseSettings& settings) {
  const Pose inverse = pose.inverse();
  std::vector<int> left;
  for (std::size_t i = 0; i < m.size(); ++i) {
    const double wide = 2 * settings.inlier_threshold;
    if (detail::squaredError(m, i, inverse) > wide * wide) left.push_back(static_cast<int>(i));
  }
  if (left.size() < 5) return std::nullopt;
  const Matches rest = detail::subset(m, left);
  PoseSettings few = settings;
  few.min_inliers = 5;
  const auto start = detail::search(rest, prior, few, std::min(300, settings.max_iterations));
  if (!start) return std::nullopt;
  const auto refined = detail::converge(m, detail::inliersOf(m, *start, settings.inlier_threshold), *start,
                                        settings.inlier_threshold / 3, prior, few);
  const Pose T = refined ? *refined : *start;
  const Matches own = detail::subset(m, inliers);
  const std::size_t common = detail::inliersOf(own, T, settings.inlier_threshold).size();
  if (2 * common > inliers.size()) return std::nullopt;  // the same pose, bent
  return T;
}

}  // namespace

void PoseSettings::validate() const {
  require(inlier_threshold > 0 && std::isfinite(inlier_threshold), "pose: inlier_threshold must be positive");
  require(pixel_stddev > 0 && pixel_stddev < inlier_threshold,
          "pose: pixel_stddev must be positive and below inlier_threshold");
  require(max_iterations >= 1, "pose: max_iterations must be at least 1");
  require(confidence > 0 && confidence < 1, "pose: confidence must lie between 0 and 1");
  require(min_inliers >= 5, "pose: min_inliers must be at least 5");
  require(max_range > 0, "pose: max_range must be positive");
  require(monte_carlo_samples >= 0, "pose: monte_carlo_samples must not be negative");
}

PoseResult estimatePose(const std::vector<Correspondence>& correspondences, const CameraModel& camera,
                        const PointSource& source, const PosePrior& prior, const PoseSettings& settings,
                        std::size_t first_dropped) {
  camera.validate();
  settings.validate();
  validate(source);
  validate(prior);
  PoseResult result;
  Matches all = detail::prepare(correspondences, camera);
  std::vector<int> kept;
  for (std::size_t i = 0; i < all.size() && static_cast<std::size_t>(all.index[i]) < first_dropped; ++i)
    kept.push_back(static_cast<int>(i));
  Matches m = detail::subset(all, kept);  // the first of `all`: positions are the same
  const auto refuse = [&](const std::string& why) {
    PoseResult failed;
    failed.reason = why;
    return failed;
  };
  const auto ofAll = [&](std::size_t count) {
    return std::to_string(count) + " of " + std::to_string(m.size()) + " matches";
  };
  if (static_cast<int>(m.size()) < settings.min_inliers) {
    return refuse("only " + std::to_string(m.size()) + " usable matches, " + std::to_string(settings.min_inliers) +
                  " needed");
  }

  const auto start = detail::search(m, prior, settings, settings.max_iterations);
  if (!start)
    return refuse("no sample of three matches gives a possible pose: points on a line, or walls seen from behind");
  std::vector<int> inliers = detail::inliersOf(m, *start, settings.inlier_threshold);
  if (static_cast<int>(inliers.size()) < settings.min_inliers)
    return refuse("only " + ofAll(inliers.size()) + " agree on a pose");

  // EPnP is a second start beside RANSAC's locally optimised pose; Levenberg-Marquardt from the better of the two.
  const double infinite = std::numeric_limits<double>::infinity();
  Pose pose = *start;
  if (const auto linear = epnp(m, inliers)) {
    const auto cost = [&](const Pose& T) { return detail::truncatedCost(m, T, settings.inlier_threshold, infinite); };
    if (cost(*linear) < cost(pose)) pose = *linear;
  }
  inliers = detail::inliersOf(m, pose, settings.inlier_threshold);
  auto refined = detail::converge(m, inliers, pose, noiseOf(m, inliers, pose, settings), prior, settings);
  if (!refined) return refuse("the refinement fails: the inliers do not fix the pose");
  pose = *refined;
  inliers = detail::inliersOf(m, pose, settings.inlier_threshold);
  if (static_cast<int>(inliers.size()) < settings.min_inliers)
    return refuse("only " + ofAll(inliers.size()) + " agree on the refined pose");
  double noise = noiseOf(m, inliers, pose, settings);
  bool moved_walls = false;
  if (auto adjusted = detail::adjustWalls(all, m.size(), pose, noise, source, prior, settings)) {
    Matches moved = detail::subset(adjusted->matches, kept);
    const Pose& T = adjusted->T_world_camera;
    const std::vector<int> agreeing = detail::inliersOf(moved, T, settings.inlier_threshold);
    if (const auto again =
            detail::converge(moved, agreeing, T, noiseOf(moved, agreeing, T, settings), prior, settings)) {
      all = std::move(adjusted->matches), m = std::move(moved), pose = *again, moved_walls = true;
      inliers = detail::inliersOf(m, pose, settings.inlier_threshold);
      noise = noiseOf(m, inliers, pose, settings);
    }
  }

  // The other poses of a plane; the likeliest wins, the next is what it must be told from.
  std::vector<Pose> poses = detail::planarAlternatives(m, pose, inliers, noise, prior, settings);
  poses.insert(poses.begin(), pose);
  std::size_t best = 0;
  for (std::size_t k = 1; k < poses.size(); ++k) {
    if (detail::logLikelihoodRatio(m, poses[k], poses[best], prior, settings) > 0) best = k;
  }
  pose = poses[best];
  for (std::size_t k = 0; k < poses.size(); ++k) {
    if (k == best) continue;
    const double margin = detail::logLikelihoodRatio(m, pose, poses[k], prior, settings);
    if (margin >= result.alternative_margin) continue;
    result.alternative_margin = margin;
    result.alternative = hypothesis(m, poses[k], correspondences, camera, settings);
  }
  if (best != 0) {
    inliers = detail::inliersOf(m, pose, settings.inlier_threshold);
    refined = detail::converge(m, inliers, pose, noise, prior, settings);
    if (refined) pose = *refined;
    inliers = detail::inliersOf(m, pose, settings.inlier_threshold);
    if (static_cast<int>(inliers.size()) < settings.min_inliers)
      return refuse("only " + ofAll(inliers.size()) + " agree on the likelier of two poses");
  }

  const auto covariance = detail::poseCovariance(m, inliers, pose, source, prior, settings);
  if (!covariance) return refuse("the inliers do not fix the pose: points on a line or at one place");
  static_cast<PoseHypothesis&>(result) = hypothesis(m, pose, correspondences, camera, settings);
  result.covariance = covariance->total;
  result.image_covariance = covariance->image;
  result.noise = covariance->noise;
  if (settings.find_competitor) {
    if (const auto other = findCompetitor(all, pose, inliers, prior, settings))
      result.competitor = hypothesis(all, *other, correspondences, camera, settings);
  }
  if (settings.monte_carlo_samples > 0) {
    result.monte_carlo_covariance =
        detail::monteCarloCovariance(m, inliers, pose, source, settings, &result.monte_carlo_plausible);
  }
  if (moved_walls) {
    result.wall_shifts.assign(correspondences.size(), Eigen::Vector3d::Zero());
    for (std::size_t i = 0; i < all.size(); ++i)
      result.wall_shifts[all.index[i]] = all.points[i].p_map - correspondences[all.index[i]].p_world;
  }
  result.success = true;
  return result;
}

std::vector<Correspondence> onMovedWalls(std::vector<Correspondence> correspondences, const PoseResult& result) {
  for (std::size_t i = 0; i < result.wall_shifts.size() && i < correspondences.size(); ++i)
    correspondences[i].p_world += result.wall_shifts[i];
  return correspondences;
}

PoseHypothesis scorePose(const Pose& T_world_camera, const std::vector<Correspondence>& correspondences,
                         const CameraModel& camera, const PoseSettings& settings) {
  return hypothesis(detail::prepare(correspondences, camera), T_world_camera, correspondences, camera, settings);
}

Matrix6d covarianceAt(const Matrix6d& covariance, const Eigen::Vector3d& lever) {
  Matrix6d J = Matrix6d::Identity();  // d (p + lever) = dp + rot x lever
  J.topRightCorner<3, 3>() = -air_ground_common::skew(lever);
  return J * covariance * J.transpose();
}

Eigen::Matrix4d xyzYawCovariance(const Matrix6d& covariance) {
  const int index[4] = {0, 1, 2, 5};
  Eigen::Matrix4d C;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) C(i, j) = covariance(index[i], index[j]);
  }
  return C;
}

}  // namespace streetview_localizer
