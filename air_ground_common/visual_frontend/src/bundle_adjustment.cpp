#include "visual_frontend/bundle_adjustment.h"

#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <unordered_map>

#include "ceres_costs.h"

namespace visual_frontend {

namespace {

void check(const BundleProblem& problem) {
  const auto fail = [](const std::string& what) { throw std::invalid_argument("solveBundle: " + what); };
  const int cameras = static_cast<int>(problem.cameras.size()), points = static_cast<int>(problem.points.size());
  if (!problem.point_fixed.empty() && static_cast<int>(problem.point_fixed.size()) != points)
    fail("point_fixed must be empty or as long as points");
  for (const auto& c : problem.cameras) {
    if (!air_ground_common::isValid(c.T_map_camera)) fail("a camera pose is not finite or not a rotation");
    if (c.up_camera && !(c.up_camera->norm() > 0.5 && c.up_sigma > 0))
      fail("a gravity prior needs a unit vector and a positive sigma");
  }
  for (const auto& p : problem.points) {
    if (!p.allFinite()) fail("a point is not finite");
  }
  for (const auto& m : problem.measurements) {
    if (m.camera < 0 || m.camera >= cameras || m.point < 0 || m.point >= points)
      fail("a measurement's index is out of range");
    if (!m.normalized.allFinite() || !(m.sigma > 0) || !(m.elongation > 0))
      fail("a measurement is not finite or its sigma not positive");
    if (m.depth > 0 && !(m.depth_sigma > 0)) fail("a depth needs a positive depth_sigma");
  }
  for (const auto& p : problem.priors) {
    if (p.camera_a < 0 || p.camera_a >= cameras || p.camera_b < 0 || p.camera_b >= cameras || p.camera_a == p.camera_b)
      fail("a prior's index is out of range");
  }
}

/// Squared reprojection error in sigmas; huge behind the camera.
double squaredError(const BundleProblem& problem, const BundleProblem::Measurement& m) {
  const Pose& T = problem.cameras[m.camera].T_map_camera;
  const Eigen::Vector3d p = T.linear().transpose() * (problem.points[m.point] - T.translation());
  if (!(p.z() > 1e-4)) return 1e12;
  return squaredSigmas(p.head<2>() / p.z() - m.normalized, m.normalized, {m.sigma, m.elongation});
}

ceres::LossFunction* makeLoss(RobustLoss loss, double width) {
  switch (loss) {
    case RobustLoss::kHuber:
      return new ceres::HuberLoss(width);
    case RobustLoss::kCauchy:
      return new ceres::CauchyLoss(width);
    case RobustLoss::kNone:
      break;
  }
  return nullptr;
}

/// A problem as Ceres takes it, and back.
class Solver {
 public:
  Solver(BundleProblem& problem, const BundleSettings& settings)
      : problem_(problem),
        settings_(settings),
        camera_(problem.cameras.size(), Vector6d::Zero()),
        camera_used_(problem.cameras.size(), 0),
        point_used_(problem.points.size(), 0),
        loss_(makeLoss(settings.loss, settings.loss_width)),
        depth_loss_(settings.depth_loss_width),
        ceres_(borrowedLosses()),
        ordering_(std::make_shared<ceres::ParameterBlockOrdering>()) {
    for (std::size_t i = 0; i < camera_.size(); ++i) {
      camera_[i].head<3>() = problem.cameras[i].T_map_camera.translation();
      R_0_.push_back(problem.cameras[i].T_map_camera.linear());
    }
    addMeasurements();
    addPriors();
    addCameras();
    addPoints();
  }

  ceres::Solver::Summary solve() {
    ceres::Solver::Options options;
    options.linear_solver_ordering = ordering_;
    options.linear_solver_type = free_cameras_ <= 30 ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
    options.max_num_iterations = settings_.max_iterations;
    options.max_solver_time_in_seconds = settings_.max_seconds;
    options.num_threads = settings_.threads;
    options.function_tolerance = 1e-5;
    options.parameter_tolerance = 1e-7;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &ceres_, &summary);
    if (summary.IsSolutionUsable()) apply();
    return summary;
  }

 private:
  static ceres::Problem::Options borrowedLosses() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }

  void addMeasurements() {
    for (const auto& m : problem_.measurements) {
      // A point behind its camera at the start has no gradient that helps: it is reported as an outlier.
      if (squaredError(problem_, m) >= 1e12) continue;
      double* x_camera = camera_[m.camera].data();
      double* x_point = problem_.points[m.point].data();
      ceres_.AddResidualBlock(new ReprojectionCost(R_0_[m.camera], m.normalized, {m.sigma, m.elongation}), loss_.get(),
                              x_camera, x_point);
      if (settings_.use_depth && m.depth > 0)
        ceres_.AddResidualBlock(new DepthCost(R_0_[m.camera], m.depth, m.depth_sigma), &depth_loss_, x_camera, x_point);
      camera_used_[m.camera] = point_used_[m.point] = 1;
    }
  }

  void addPriors() {
    for (const auto& p : problem_.priors) {
      Vector6d weights = Vector6d::Zero();
      if (p.translation_sigma > 0) weights.head<3>().setConstant(1 / p.translation_sigma);
      if (p.rotation_sigma > 0) weights.tail<3>().setConstant(1 / p.rotation_sigma);
      ceres_.AddResidualBlock(
          new RelativePoseCost<6>(R_0_[p.camera_a], R_0_[p.camera_b], p.T_a_b, weights.asDiagonal()), nullptr,
          camera_[p.camera_a].data(), camera_[p.camera_b].data());
      camera_used_[p.camera_a] = camera_used_[p.camera_b] = 1;
    }
  }

  void addCameras() {
    for (std::size_t i = 0; i < camera_.size(); ++i) {
      const auto& c = problem_.cameras[i];
      if (settings_.use_gravity && c.up_camera && !c.fixed) {
        ceres_.AddResidualBlock(new GravityCost(R_0_[i], *c.up_camera, c.up_sigma), nullptr, camera_[i].data());
        camera_used_[i] = 1;
      }
      if (!camera_used_[i]) continue;
      ordering_->AddElementToGroup(camera_[i].data(), 1);
      if (c.fixed)
        ceres_.SetParameterBlockConstant(camera_[i].data());
      else
        ++free_cameras_;
    }
  }

  void addPoints() {
    for (std::size_t i = 0; i < problem_.points.size(); ++i) {
      if (!point_used_[i]) continue;
      ordering_->AddElementToGroup(problem_.points[i].data(), 0);
      if (!problem_.point_fixed.empty() && problem_.point_fixed[i])
        ceres_.SetParameterBlockConstant(problem_.points[i].data());
    }
  }

  void apply() {
    for (std::size_t i = 0; i < camera_.size(); ++i) {
      auto& c = problem_.cameras[i];
      if (c.fixed || !camera_used_[i]) continue;
      c.T_map_camera.translation() = camera_[i].head<3>();
      c.T_map_camera.linear() = expSO3(camera_[i].tail<3>()) * R_0_[i];
      c.T_map_camera = air_ground_common::normalized(c.T_map_camera);
    }
  }

  BundleProblem& problem_;
  const BundleSettings& settings_;
  std::vector<Vector6d> camera_;  // centre, rotation vector from R_0
  std::vector<Eigen::Matrix3d> R_0_;
  std::vector<unsigned char> camera_used_, point_used_;
  std::unique_ptr<ceres::LossFunction> loss_;
  ceres::CauchyLoss depth_loss_;
  ceres::Problem ceres_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_;
  int free_cameras_ = 0;
};

/// A part of a map as a problem, with where each piece came from.
struct MapProblem {
  BundleProblem problem;
  std::vector<KeyframeId> keyframes;         ///< of the cameras
  std::vector<LandmarkId> landmarks;         ///< of the points
  std::vector<LandmarkObservation> sources;  ///< of the measurements
};

MapProblem extract(const Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                   const std::vector<KeyframeId>& fixed, const BundleSettings& settings) {
  MapProblem part;
  std::unordered_map<KeyframeId, int> camera_index;
  const auto addCamera = [&](KeyframeId id, bool held) {
    if (!camera_index.emplace(id, static_cast<int>(part.keyframes.size())).second) return;
    const Keyframe& keyframe = map.keyframe(id);
    part.problem.cameras.push_back({keyframe.T_map_camera, held, keyframe.up_camera, keyframe.up_sigma});
    part.keyframes.push_back(id);
  };
  for (const KeyframeId id : fixed) addCamera(id, true);
  for (const KeyframeId id : free) addCamera(id, false);
  if (fixed.empty() && !part.problem.cameras.empty()) part.problem.cameras.front().fixed = true;

  const std::vector<LandmarkId> landmarks = map.landmarksOf(free);
  part.problem.points.reserve(landmarks.size());
  for (const LandmarkId id : landmarks) {
    const Landmark& landmark = map.landmark(id);
    bool depth = false;
    int views = 0;
    for (const LandmarkObservation& o : landmark.observations) {
      if (!camera_index.count(o.keyframe)) continue;
      ++views;
      depth = depth || (settings.use_depth && map.keyframe(o.keyframe).observations[o.index].depth > 0);
    }
    if (views < 2 && !depth) continue;
    const int point = static_cast<int>(part.landmarks.size());
    part.problem.points.push_back(landmark.position);
    part.landmarks.push_back(id);
    for (const LandmarkObservation& o : landmark.observations) {
      const auto it = camera_index.find(o.keyframe);
      if (it == camera_index.end()) continue;
      const Observation& seen = map.keyframe(o.keyframe).observations[o.index];
      const NormalizedNoise noise = camera.normalizedNoise(seen.normalized, settings.pixel_sigma);
      part.problem.measurements.push_back(
          {it->second, point, seen.normalized, noise.sigma, seen.depth, seen.depth_sigma, noise.elongation});
      part.sources.push_back(o);
    }
  }
  return part;
}

/// Disconnects the measurements; landmarks left with one observation without depth go.
void removeOutliers(const MapProblem& part, const std::vector<int>& outliers, Map& map) {
  for (const int i : outliers) map.disconnect(part.sources[i].keyframe, part.sources[i].index);
  for (const int i : outliers) {
    const LandmarkId id = part.landmarks[part.problem.measurements[i].point];
    if (!map.hasLandmark(id)) continue;
    const Landmark& landmark = map.landmark(id);
    if (landmark.observations.size() >= 2) continue;
    const LandmarkObservation& o = landmark.observations.front();
    if (!(map.keyframe(o.keyframe).observations[o.index].depth > 0)) map.removeLandmark(id);
  }
}

}  // namespace

BundleResult solveBundle(BundleProblem& problem, const BundleSettings& settings) {
  check(problem);
  const ceres::Solver::Summary summary = Solver(problem, settings).solve();
  BundleResult result;
  result.usable = summary.IsSolutionUsable();
  result.message = summary.message;
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.iterations = static_cast<int>(summary.iterations.size());
  result.seconds = summary.total_time_in_seconds;
  double sum = 0;
  std::size_t inliers = 0;
  for (std::size_t i = 0; i < problem.measurements.size(); ++i) {
    const double e2 = squaredError(problem, problem.measurements[i]);
    if (e2 > settings.outlier_threshold * settings.outlier_threshold) {
      result.outliers.push_back(static_cast<int>(i));
    } else {
      sum += e2;
      ++inliers;
    }
  }
  result.rms = inliers > 0 ? std::sqrt(sum / (2.0 * inliers)) : 0;
  return result;
}

BundleResult adjustMap(Map& map, const CameraModel& camera, const std::vector<KeyframeId>& free,
                       const std::vector<KeyframeId>& fixed, const BundleSettings& settings) {
  MapProblem part = extract(map, camera, free, fixed, settings);
  BundleResult result = solveBundle(part.problem, settings);
  if (!result.usable) return result;
  for (std::size_t i = 0; i < part.keyframes.size(); ++i) {
    const auto& c = part.problem.cameras[i];
    if (!c.fixed) map.keyframe(part.keyframes[i]).T_map_camera = c.T_map_camera;
  }
  for (std::size_t i = 0; i < part.landmarks.size(); ++i)
    map.landmark(part.landmarks[i]).position = part.problem.points[i];
  if (settings.remove_outliers) removeOutliers(part, result.outliers, map);
  return result;
}

BundleResult adjustFullMap(Map& map, const CameraModel& camera, const std::vector<KeyframeId>& fixed,
                           const BundleSettings& settings) {
  std::vector<KeyframeId> free, held = fixed;
  if (held.empty() && map.keyframeCount() > 0) held.push_back(map.keyframes().begin()->first);
  for (const auto& [id, keyframe] : map.keyframes()) {
    if (std::find(held.begin(), held.end(), id) == held.end()) free.push_back(id);
  }
  return adjustMap(map, camera, free, held, settings);
}

}  // namespace visual_frontend
