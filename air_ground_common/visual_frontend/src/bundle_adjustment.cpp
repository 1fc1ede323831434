#include "visual_frontend/bundle_adjustment.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <unordered_map>

#include "visual_frontend/bundle_solver.h"

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

struct Camera {
  Vector6d camera;
};

class Solver : BundleSolver<Camera> {
 public:
  Solver(BundleProblem& problem, const BundleSettings& settings)
      : BundleSolver(problem, settings.loss, settings.loss_width),
        settings_(settings),
        depth_loss_(settings.depth_loss_width) {
    addMeasurements([this](const BundleProblem::Measurement& m) {
      if (settings_.use_depth && m.depth > 0)
        ceres_.AddResidualBlock(new DepthCost(R_0_[m.camera], m.depth, m.depth_sigma), &depth_loss_,
                                block_[m.camera].camera.data(), problem_.points[m.point].data());
    });
    addPriors();
    for (std::size_t i = 0; i < block_.size(); ++i) {
      const auto& c = problem_.cameras[i];
      if (settings_.use_gravity) {
        addGravity(i);
        if (c.up_camera && !c.fixed) camera_used_[i] = 1;
      }
      if (camera_used_[i]) addCamera(i);
    }
    addPoints();
  }

  ceres::Solver::Summary solve() {
    return BundleSolver::solve({settings_.max_iterations, settings_.max_seconds, settings_.threads});
  }

 private:
  void addPriors() {
    for (const auto& p : problem_.priors) {
      Vector6d weights = Vector6d::Zero();
      if (p.translation_sigma > 0) weights.head<3>().setConstant(1 / p.translation_sigma);
      if (p.rotation_sigma > 0) weights.tail<3>().setConstant(1 / p.rotation_sigma);
      ceres_.AddResidualBlock(
          new RelativePoseCost<6>(R_0_[p.camera_a], R_0_[p.camera_b], p.T_a_b, weights.asDiagonal()), nullptr,
          block_[p.camera_a].camera.data(), block_[p.camera_b].camera.data());
      camera_used_[p.camera_a] = camera_used_[p.camera_b] = 1;
    }
  }

  const BundleSettings& settings_;
  ceres::CauchyLoss depth_loss_;
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

double squaredError(const BundleProblem& problem, const BundleProblem::Measurement& m) {
  const Pose& T = problem.cameras[m.camera].T_map_camera;
  const Eigen::Vector3d p = T.linear().transpose() * (problem.points[m.point] - T.translation());
  if (!(p.z() > 1e-4)) return kBehindCamera;
  return squaredSigmas(p.head<2>() / p.z() - m.normalized, m.normalized, {m.sigma, m.elongation});
}

std::unique_ptr<ceres::LossFunction> makeLoss(RobustLoss loss, double width) {
  switch (loss) {
    case RobustLoss::kHuber:
      return std::make_unique<ceres::HuberLoss>(width);
    case RobustLoss::kCauchy:
      return std::make_unique<ceres::CauchyLoss>(width);
    case RobustLoss::kNone:
      break;
  }
  return nullptr;
}

BundleResult bundleResult(const ceres::Solver::Summary& summary, const BundleProblem& problem,
                          double outlier_threshold) {
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
    if (e2 > outlier_threshold * outlier_threshold) {
      result.outliers.push_back(static_cast<int>(i));
    } else {
      sum += e2;
      ++inliers;
    }
  }
  result.rms = inliers > 0 ? std::sqrt(sum / (2.0 * static_cast<double>(inliers))) : 0;
  return result;
}

BundleResult solveBundle(BundleProblem& problem, const BundleSettings& settings) {
  check(problem);
  const ceres::Solver::Summary summary = Solver(problem, settings).solve();
  return bundleResult(summary, problem, settings.outlier_threshold);
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
