#include "streetview_localizer/pose_estimation.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <opengv/absolute_pose/CentralAbsoluteAdapter.hpp>
#include <opengv/absolute_pose/methods.hpp>
#include <stdexcept>

#include "air_ground_common/statistics.h"
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
  for (const double s : {source.position_stddev, source.orientation_stddev, source.model_lateral_stddev,
                         source.model_relief_stddev, source.model_height_stddev}) {
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
  return std::max(settings.pixel_stddev, air_ground_common::median(std::move(errors)) / 1.1774);
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

/// The steps from matches to a pose; each returns false, with `reason`, where there is none.
class Estimation {
 public:
  Estimation(const std::vector<Correspondence>& correspondences, const CameraModel& camera, const PointSource& source,
             const PosePrior& prior, const PoseSettings& settings, std::size_t first_dropped)
      : correspondences_(correspondences),
        camera_(camera),
        source_(source),
        prior_(prior),
        settings_(settings),
        all_(detail::prepare(correspondences, camera)) {
    for (std::size_t i = 0; i < all_.size() && static_cast<std::size_t>(all_.index[i]) < first_dropped; ++i)
      kept_.push_back(static_cast<int>(i));
    m_ = detail::subset(all_, kept_);
  }

  PoseResult run() {
    PoseResult result = found();
    if (!prior_.up_camera) return result;
    constexpr double kDoubtful = 0.3;  // of the matches
    const std::size_t inliers = result.inliers.size();
    double off = result.success ? detail::tilt(prior_, result.T_world_camera) : 0;
    if (static_cast<double>(inliers) < kDoubtful * static_cast<double>(m_.size()))
      off = std::max(off, tiltOfMore(inliers));
    if (off <= detail::mostTilt(prior_)) return result;
    refuse("the matches agree on an attitude " + std::to_string(std::lround(off * 180 / M_PI)) +
           " degrees off gravity: is mav/odometry level with z up, and is the camera's frame optical (z forward)?");
    return failed();
  }

 private:
  PoseResult found() {
    if (!start() || !refine()) return failed();
    moveWalls();
    if (!chooseOnPlane()) return failed();
    return conclude();
  }

  bool refuse(const std::string& why) {
    reason_ = why;
    return false;
  }
  PoseResult failed() const {
    PoseResult result;
    result.reason = reason_;
    return result;
  }
  std::string ofAll(std::size_t count) const {
    return std::to_string(count) + " of " + std::to_string(m_.size()) + " matches";
  }
  std::vector<int> inliersOf(const Matches& m, const Pose& T) const {
    return detail::inliersOf(m, T, settings_.inlier_threshold);
  }
  bool tooFew() const { return static_cast<int>(inliers_.size()) < settings_.min_inliers; }
  PoseHypothesis hypothesisOf(const Matches& m, const Pose& T) const {
    return hypothesis(m, T, correspondences_, camera_, settings_);
  }

  /// RANSAC; EPnP is a second start beside its locally optimised pose.
  bool start() {
    if (static_cast<int>(m_.size()) < settings_.min_inliers)
      return refuse("only " + std::to_string(m_.size()) + " usable matches, " + std::to_string(settings_.min_inliers) +
                    " needed");
    const auto start = detail::search(m_, prior_, settings_, settings_.max_iterations);
    if (!start)
      return refuse("no sample of three matches gives a possible pose: points on a line, or walls seen from behind");
    inliers_ = inliersOf(m_, *start);
    if (tooFew()) return refuse("only " + ofAll(inliers_.size()) + " agree on a pose");
    pose_ = *start;
    if (const auto linear = epnp(m_, inliers_)) {
      const auto cost = [&](const Pose& T) {
        return detail::truncatedCost(m_, T, settings_.inlier_threshold, std::numeric_limits<double>::infinity());
      };
      if (cost(*linear) < cost(pose_)) pose_ = *linear;
    }
    return true;
  }

  /// Where nothing, or a pose of a few chance inliers, fits the direction of gravity: how far from it the attitude is
  /// on which far more matches agree without it [rad]; 0 where there is none.
  double tiltOfMore(std::size_t inliers) const {
    constexpr int kMostTries = 300;  // hopeless images, which come here too, shall not take twice the time
    const std::size_t needed = std::max<std::size_t>(settings_.min_inliers, 2 * inliers);
    if (m_.size() < needed) return 0;
    PosePrior free = prior_;
    free.up_camera.reset();
    const auto start = detail::search(m_, free, settings_, std::min(kMostTries, settings_.max_iterations));
    if (!start) return 0;
    const auto T = detail::converge(m_, inliersOf(m_, *start), *start, settings_.inlier_threshold / 3, free, settings_);
    return T && inliersOf(m_, *T).size() >= needed ? detail::tilt(prior_, *T) : 0;
  }

  /// Levenberg-Marquardt from the better of the two.
  bool refine() {
    inliers_ = inliersOf(m_, pose_);
    const auto refined =
        detail::converge(m_, inliers_, pose_, noiseOf(m_, inliers_, pose_, settings_), prior_, settings_);
    if (!refined) return refuse("the refinement fails: the inliers do not fix the pose");
    pose_ = *refined;
    inliers_ = inliersOf(m_, pose_);
    if (tooFew()) return refuse("only " + ofAll(inliers_.size()) + " agree on the refined pose");
    noise_ = noiseOf(m_, inliers_, pose_, settings_);
    return true;
  }

  /// The walls of the model are off by decimetres: they move with the pose, where that helps.
  void moveWalls() {
    auto adjusted = detail::adjustWalls(all_, m_.size(), pose_, noise_, source_, prior_, settings_);
    if (!adjusted) return;
    Matches moved = detail::subset(adjusted->matches, kept_);
    const Pose& T = adjusted->T_world_camera;
    const std::vector<int> agreeing = inliersOf(moved, T);
    const auto again = detail::converge(moved, agreeing, T, noiseOf(moved, agreeing, T, settings_), prior_, settings_);
    if (!again) return;
    all_ = std::move(adjusted->matches);
    m_ = std::move(moved);
    pose_ = *again;
    moved_walls_ = true;
    inliers_ = inliersOf(m_, pose_);
    noise_ = noiseOf(m_, inliers_, pose_, settings_);
  }

  /// The other poses of a plane; the likeliest wins, the next is what it must be told from.
  bool chooseOnPlane() {
    std::vector<Pose> poses = detail::planarAlternatives(m_, pose_, inliers_, noise_, prior_, settings_);
    poses.insert(poses.begin(), pose_);
    std::size_t best = 0;
    for (std::size_t k = 1; k < poses.size(); ++k)
      if (detail::logLikelihoodRatio(m_, poses[k], poses[best], prior_, settings_) > 0) best = k;
    pose_ = poses[best];
    for (std::size_t k = 0; k < poses.size(); ++k) {
      if (k == best) continue;
      const double margin = detail::logLikelihoodRatio(m_, pose_, poses[k], prior_, settings_);
      if (margin >= result_.alternative_margin) continue;
      result_.alternative_margin = margin;
      result_.alternative = hypothesisOf(m_, poses[k]);
    }
    if (best == 0) return true;
    inliers_ = inliersOf(m_, pose_);
    if (const auto refined = detail::converge(m_, inliers_, pose_, noise_, prior_, settings_)) pose_ = *refined;
    inliers_ = inliersOf(m_, pose_);
    return !tooFew() || refuse("only " + ofAll(inliers_.size()) + " agree on the likelier of two poses");
  }

  PoseResult conclude() {
    const auto covariance = detail::poseCovariance(m_, inliers_, pose_, source_, prior_, settings_);
    if (!covariance) {
      refuse("the inliers do not fix the pose: points on a line or at one place");
      return failed();
    }
    static_cast<PoseHypothesis&>(result_) = hypothesisOf(m_, pose_);
    result_.covariance = covariance->total;
    result_.image_covariance = covariance->image;
    result_.noise = covariance->noise;
    if (settings_.find_competitor)
      if (const auto other = findCompetitor(all_, pose_, inliers_, prior_, settings_))
        result_.competitor = hypothesisOf(all_, *other);
    if (settings_.monte_carlo_samples > 0)
      result_.monte_carlo_covariance =
          detail::monteCarloCovariance(m_, inliers_, pose_, source_, settings_, &result_.monte_carlo_plausible);
    if (moved_walls_) {
      result_.wall_shifts.assign(correspondences_.size(), Eigen::Vector3d::Zero());
      for (std::size_t i = 0; i < all_.size(); ++i)
        result_.wall_shifts[all_.index[i]] = all_.points[i].p_map - correspondences_[all_.index[i]].p_world;
    }
    result_.success = true;
    return result_;
  }

  const std::vector<Correspondence>& correspondences_;
  const CameraModel& camera_;
  const PointSource& source_;
  const PosePrior& prior_;
  const PoseSettings& settings_;
  Matches all_, m_;        ///< m_: those before first_dropped, the first of all_: positions are the same
  std::vector<int> kept_;  ///< of all_, the positions of m_
  Pose pose_ = Pose::Identity();
  std::vector<int> inliers_;  ///< of m_
  double noise_ = 0;
  bool moved_walls_ = false;
  PoseResult result_;
  std::string reason_;
};

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
  return Estimation(correspondences, camera, source, prior, settings, first_dropped).run();
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

}  // namespace streetview_localizer
