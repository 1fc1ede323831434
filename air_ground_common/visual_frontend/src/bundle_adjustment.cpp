#include "visual_frontend/bundle_adjustment.h"

#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>
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

}  // namespace

BundleResult solveBundle(BundleProblem& problem, const BundleSettings& settings) {
  check(problem);
  const auto isFixed = [&](int point) { return !problem.point_fixed.empty() && problem.point_fixed[point]; };
  std::vector<Vector6d> camera(problem.cameras.size(), Vector6d::Zero());
  std::vector<Eigen::Matrix3d> R_0;
  for (std::size_t i = 0; i < camera.size(); ++i) {
    camera[i].head<3>() = problem.cameras[i].T_map_camera.translation();
    R_0.push_back(problem.cameras[i].T_map_camera.linear());
  }

  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem solver_problem(options);
  const std::unique_ptr<ceres::LossFunction> loss(makeLoss(settings.loss, settings.loss_width));
  ceres::CauchyLoss depth_loss(settings.depth_loss_width);
  std::vector<unsigned char> camera_used(camera.size(), 0), point_used(problem.points.size(), 0);
  for (const auto& m : problem.measurements) {
    // A point behind its camera at the start has no gradient that helps: it is reported as an outlier below.
    if (squaredError(problem, m) >= 1e12) continue;
    double* x_camera = camera[m.camera].data();
    double* x_point = problem.points[m.point].data();
    solver_problem.AddResidualBlock(new ReprojectionCost(R_0[m.camera], m.normalized, {m.sigma, m.elongation}),
                                    loss.get(), x_camera, x_point);
    if (settings.use_depth && m.depth > 0) {
      solver_problem.AddResidualBlock(new DepthCost(R_0[m.camera], m.depth, m.depth_sigma), &depth_loss, x_camera,
                                      x_point);
    }
    camera_used[m.camera] = point_used[m.point] = 1;
  }
  for (const auto& p : problem.priors) {
    Vector6d weights = Vector6d::Zero();
    if (p.translation_sigma > 0) weights.head<3>().setConstant(1 / p.translation_sigma);
    if (p.rotation_sigma > 0) weights.tail<3>().setConstant(1 / p.rotation_sigma);
    solver_problem.AddResidualBlock(
        new RelativePoseCost<6>(R_0[p.camera_a], R_0[p.camera_b], p.T_a_b, weights.asDiagonal()), nullptr,
        camera[p.camera_a].data(), camera[p.camera_b].data());
    camera_used[p.camera_a] = camera_used[p.camera_b] = 1;
  }
  int free_cameras = 0;
  ceres::ParameterBlockOrdering* ordering = new ceres::ParameterBlockOrdering;
  for (std::size_t i = 0; i < camera.size(); ++i) {
    const auto& c = problem.cameras[i];
    if (settings.use_gravity && c.up_camera && !c.fixed) {
      solver_problem.AddResidualBlock(new GravityCost(R_0[i], *c.up_camera, c.up_sigma), nullptr, camera[i].data());
      camera_used[i] = 1;
    }
    if (!camera_used[i]) continue;
    ordering->AddElementToGroup(camera[i].data(), 1);
    if (c.fixed)
      solver_problem.SetParameterBlockConstant(camera[i].data());
    else
      ++free_cameras;
  }
  for (std::size_t i = 0; i < problem.points.size(); ++i) {
    if (!point_used[i]) continue;
    ordering->AddElementToGroup(problem.points[i].data(), 0);
    if (isFixed(static_cast<int>(i))) solver_problem.SetParameterBlockConstant(problem.points[i].data());
  }

  BundleResult result;
  ceres::Solver::Options solver;
  solver.linear_solver_ordering.reset(ordering);
  solver.linear_solver_type = free_cameras <= 30 ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  solver.max_num_iterations = settings.max_iterations;
  solver.max_solver_time_in_seconds = settings.max_seconds;
  solver.num_threads = settings.threads;
  solver.function_tolerance = 1e-5;
  solver.parameter_tolerance = 1e-7;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &solver_problem, &summary);
  result.usable = summary.IsSolutionUsable();
  result.message = summary.message;
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.iterations = static_cast<int>(summary.iterations.size());
  result.seconds = summary.total_time_in_seconds;
  if (result.usable) {
    for (std::size_t i = 0; i < camera.size(); ++i) {
      auto& c = problem.cameras[i];
      if (c.fixed || !camera_used[i]) continue;
      c.T_map_camera.translation() = camera[i].head<3>();
      c.T_map_camera.linear() = expSO3(camera[i].tail<3>()) * R_0[i];
      c.T_map_camera = air_ground_common::normalized(c.T_map_camera);
    }
  }
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
  BundleProblem problem;
  std::unordered_map<KeyframeId, int> camera_index;
  std::vector<KeyframeId> ids;
  const auto addCamera = [&](KeyframeId id, bool held) {
    if (!camera_index.emplace(id, static_cast<int>(ids.size())).second) return;
    const Keyframe& keyframe = map.keyframe(id);
    BundleProblem::Camera c;
    c.T_map_camera = keyframe.T_map_camera;
    c.fixed = held;
    c.up_camera = keyframe.up_camera;
    c.up_sigma = keyframe.up_sigma;
    problem.cameras.push_back(c);
    ids.push_back(id);
  };
  for (const KeyframeId id : fixed) addCamera(id, true);
  for (const KeyframeId id : free) addCamera(id, false);
  if (fixed.empty() && !problem.cameras.empty()) problem.cameras.front().fixed = true;

  const std::vector<LandmarkId> landmarks = map.landmarksOf(free);
  std::vector<LandmarkObservation> source;
  problem.points.reserve(landmarks.size());
  for (const LandmarkId id : landmarks) {
    const Landmark& landmark = map.landmark(id);
    const int point = static_cast<int>(problem.points.size());
    bool depth = false;
    int views = 0;
    for (const LandmarkObservation& o : landmark.observations) {
      if (!camera_index.count(o.keyframe)) continue;
      ++views;
      depth = depth || (settings.use_depth && map.keyframe(o.keyframe).observations[o.index].depth > 0);
    }
    if (views < 2 && !depth) continue;
    problem.points.push_back(landmark.position);
    for (const LandmarkObservation& o : landmark.observations) {
      const auto it = camera_index.find(o.keyframe);
      if (it == camera_index.end()) continue;
      const Observation& observation = map.keyframe(o.keyframe).observations[o.index];
      BundleProblem::Measurement m;
      m.camera = it->second;
      m.point = point;
      m.normalized = observation.normalized;
      const NormalizedNoise noise = camera.normalizedNoise(observation.normalized, settings.pixel_sigma);
      m.sigma = noise.sigma;
      m.elongation = noise.elongation;
      m.depth = observation.depth;
      m.depth_sigma = observation.depth_sigma;
      problem.measurements.push_back(m);
      source.push_back(o);
    }
  }
  std::vector<LandmarkId> point_ids;
  {
    // Points were skipped above: rebuild their ids from the first measurement of each.
    point_ids.resize(problem.points.size(), kNoLandmark);
    for (std::size_t i = 0; i < source.size(); ++i) {
      point_ids[problem.measurements[i].point] =
          map.keyframe(source[i].keyframe).observations[source[i].index].landmark;
    }
  }

  BundleResult result = solveBundle(problem, settings);
  if (!result.usable) return result;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (!problem.cameras[i].fixed) map.keyframe(ids[i]).T_map_camera = problem.cameras[i].T_map_camera;
  }
  for (std::size_t i = 0; i < point_ids.size(); ++i) map.landmark(point_ids[i]).position = problem.points[i];
  if (!settings.remove_outliers) return result;
  for (const int i : result.outliers) map.disconnect(source[i].keyframe, source[i].index);
  for (const int i : result.outliers) {
    const LandmarkId id = point_ids[problem.measurements[i].point];
    if (!map.hasLandmark(id)) continue;
    const Landmark& landmark = map.landmark(id);
    if (landmark.observations.size() >= 2) continue;
    const LandmarkObservation& o = landmark.observations.front();
    if (!(map.keyframe(o.keyframe).observations[o.index].depth > 0)) map.removeLandmark(id);
  }
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
