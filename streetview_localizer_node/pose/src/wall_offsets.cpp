#include "wall_offsets.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>

#include "planar_alternative.h"

namespace streetview_localizer::detail {

namespace {

constexpr double kReach = 3;            // inlier thresholds: a wall's matches err together
constexpr double kCauchy = 2;           // standard deviations
constexpr double kMaxOffset = 4;        // standard deviations
constexpr std::size_t kMinMatches = 8;  // of a wall
constexpr std::size_t kMinOfPatch = 4;  // fewer may all be wrong, and bend a patch of their own towards them
constexpr double kPatch = 2;            // [m]

using Step = std::array<double, 6>;  // position, rotation vector; both in world

// (R x) with R = exp(rotation) R_0, or its inverse on vectors of world.
template <typename T>
Eigen::Matrix<T, 3, 1> turned(const T* rotation, double sign, const Eigen::Matrix<T, 3, 1>& x) {
  const T angle_axis[3] = {sign * rotation[0], sign * rotation[1], sign * rotation[2]};
  Eigen::Matrix<T, 3, 1> out;
  ceres::AngleAxisRotatePoint(angle_axis, x.data(), out.data());
  return out;
}

struct Reprojection {
  Pose T;  // linearisation point
  Eigen::Vector3d point, direction;
  Eigen::Vector2d normalized;
  double weight;  // 1 / (noise in normalised coordinates)

  template <typename S>
  bool operator()(const S* step, const S* of_wall, const S* of_patch, S* residual) const {
    Eigen::Matrix<S, 3, 1> q = (point - T.translation()).cast<S>() + direction.cast<S>() * (of_wall[0] + of_patch[0]);
    q -= Eigen::Map<const Eigen::Matrix<S, 3, 1>>(step);
    const Eigen::Matrix<S, 3, 1> p = T.linear().transpose().cast<S>() * turned(step + 3, -1, q);
    if (!(p.z() > S(0.05))) return false;
    residual[0] = (p.x() / p.z() - normalized.x()) * weight;
    residual[1] = (p.y() / p.z() - normalized.y()) * weight;
    return true;
  }
};

struct Gravity {
  Eigen::Vector3d up_world;  // by the linearisation point
  double stddev;

  template <typename S>
  bool operator()(const S* step, S* residual) const {
    const Eigen::Matrix<S, 3, 1> up = turned<S>(step + 3, 1, up_world.cast<S>());
    residual[0] = up.x() / stddev;
    residual[1] = up.y() / stddev;
    return true;
  }
};

struct Offset {
  double stddev;
  template <typename S>
  bool operator()(const S* offset, S* residual) const {
    residual[0] = offset[0] / stddev;
    return true;
  }
};

}  // namespace

Eigen::Vector3d unitNormal(const Eigen::Vector3d& normal, const Eigen::Vector3d& ray) {
  return normal.squaredNorm() > 0.25 ? normal.normalized() : Eigen::Vector3d(-ray.normalized());
}

Eigen::Vector3d castDirection(const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                              const Eigen::Vector3d& centre) {
  const Eigen::Vector3d ray = point - centre;
  const double range = ray.norm();
  if (!(range > 1e-3)) return Eigen::Vector3d::Zero();
  double along = unitNormal(normal, ray).dot(ray);
  if (std::abs(along) < 0.1 * range) along = std::copysign(0.1 * range, along);
  return ray / along;
}

Patch patchOf(const Matches& m, std::size_t i) {
  const Eigen::Vector3d& n = m.normals[i];
  Eigen::Vector3d along = Eigen::Vector3d::UnitZ().cross(n);
  if (along.norm() < 0.1) along = Eigen::Vector3d::UnitX();
  along.normalize();
  const Eigen::Vector3d& p = m.points[i].p_map;
  const auto cell = [&p](const Eigen::Vector3d& axis) { return static_cast<int>(std::floor(axis.dot(p) / kPatch)); };
  return {m.wall[i], cell(along), cell(n.cross(along))};
}

namespace {

using Groups = std::map<Patch, std::vector<int>>;

/// What is estimated beside the pose: the offset of each wall, and by how much its patches stand out from it [m].
struct Offsets {
  std::map<int, double> of_wall;
  std::map<Patch, double> of_patch;

  double of(const Matches& m, std::size_t i) const {
    const auto wall = of_wall.find(m.wall[i]);
    if (wall == of_wall.end()) return 0;
    const auto patch = of_patch.find(patchOf(m, i));
    return wall->second + (patch == of_patch.end() ? 0 : patch->second);
  }
};

/// Matches that agree with the pose, by the patch that they lie on: of walls with enough of them.
Groups matchesByPatch(const Matches& m, std::size_t usable, const Pose& T, const PoseSettings& settings) {
  Groups patches;
  std::map<int, std::size_t> count;
  for (const int i : inliersOf(m, T, kReach * settings.inlier_threshold)) {
    const auto k = static_cast<std::size_t>(i);
    if (k >= usable || m.wall[k] < 0) continue;
    patches[patchOf(m, k)].push_back(i);
    ++count[m.wall[k]];
  }
  for (auto it = patches.begin(); it != patches.end();)
    it = count[it->first[0]] < kMinMatches ? patches.erase(it) : std::next(it);
  return patches;
}

void addOffset(double stddev, double* offset, ceres::Problem* problem) {
  if (stddev > 0)
    problem->AddResidualBlock(new ceres::AutoDiffCostFunction<Offset, 1, 1>(new Offset{stddev}), nullptr, offset);
  else
    problem->SetParameterBlockConstant(offset);
}

/// Pose and offsets that fit the matches best; false when the solver fails.
bool solveOffsets(const Matches& m, const Groups& patches, const Pose& start, double noise, const PointSource& source,
                  const PosePrior& prior, Step* step, Offsets* offsets) {
  ceres::Problem problem;
  std::size_t count = 0;
  for (const auto& patch : patches) count += patch.second.size();
  const double crowd = std::min(1.0, kEffectiveMeasurements / (2.0 * static_cast<double>(count)));
  double none = 0;
  problem.AddParameterBlock(&none, 1);
  problem.SetParameterBlockConstant(&none);
  for (const auto& [patch, members] : patches) {
    double* of_wall = &offsets->of_wall[patch[0]];
    double* of_patch = members.size() < kMinOfPatch ? &none : &offsets->of_patch[patch];
    for (const int i : members) {
      const auto& c = m.points[i];
      auto* cost = new ceres::AutoDiffCostFunction<Reprojection, 2, 6, 1, 1>(
          new Reprojection{start, c.p_map, castDirection(c.p_map, m.normals[i], m.centreOf(i, source)), c.normalized,
                           1 / (c.sigma * noise)});
      problem.AddResidualBlock(cost,
                               new ceres::ScaledLoss(new ceres::CauchyLoss(kCauchy), crowd, ceres::TAKE_OWNERSHIP),
                               step->data(), of_wall, of_patch);
    }
  }
  for (auto& wall : offsets->of_wall) addOffset(source.model_lateral_stddev, &wall.second, &problem);
  for (auto& patch : offsets->of_patch) addOffset(source.model_relief_stddev, &patch.second, &problem);
  if (prior.up_camera)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Gravity, 2, 6>(
                                 new Gravity{start.linear() * prior.up_camera->normalized(), prior.up_stddev}),
                             nullptr, step->data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = 30;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.IsSolutionUsable();
}

/// The matches with the points of each patch moved by its offset and its wall's.
Matches withMovedWalls(const Matches& m, const Offsets& offsets, const PointSource& source) {
  Matches moved = m;
  for (std::size_t i = 0; i < m.size(); ++i) {
    const Eigen::Vector3d shift =
        offsets.of(m, i) * castDirection(m.points[i].p_map, m.normals[i], m.centreOf(i, source));
    moved.points[i].p_map += shift;
    moved.x[i] += static_cast<float>(shift.x());
    moved.y[i] += static_cast<float>(shift.y());
    moved.z[i] += static_cast<float>(shift.z());
  }
  return moved;
}

}  // namespace

std::optional<WallAdjustment> adjustWalls(const Matches& m, std::size_t usable, const Pose& start, double noise,
                                          const PointSource& source, const PosePrior& prior,
                                          const PoseSettings& settings) {
  if (!(source.model_lateral_stddev > 0) && !(source.model_relief_stddev > 0)) return std::nullopt;
  const Groups patches = matchesByPatch(m, usable, start, settings);
  if (patches.size() < 2) return std::nullopt;

  Step step{};
  Offsets offsets;
  if (!solveOffsets(m, patches, start, noise, source, prior, &step, &offsets)) return std::nullopt;

  WallAdjustment result;
  const Eigen::Map<const air_ground_common::Vector6d> s(step.data());
  result.T_world_camera.translation() = start.translation() + s.head<3>();
  result.T_world_camera.linear() = air_ground_common::expSO3(s.tail<3>()) * start.linear();
  result.T_world_camera = air_ground_common::normalized(result.T_world_camera);
  for (const auto& wall : offsets.of_wall)
    if (std::abs(wall.second) > kMaxOffset * source.model_lateral_stddev) return std::nullopt;
  for (auto& patch : offsets.of_patch)
    if (std::abs(patch.second) > kMaxOffset * source.model_relief_stddev) patch.second = 0;
  result.matches = withMovedWalls(m, offsets, source);
  std::vector<int> positions(usable);
  std::iota(positions.begin(), positions.end(), 0);
  const auto cost = [&](const Matches& matches, const Pose& T) {
    return truncatedCost(subset(matches, positions), T, settings.inlier_threshold,
                         std::numeric_limits<double>::infinity());
  };
  if (!(cost(result.matches, result.T_world_camera) < cost(m, start))) return std::nullopt;
  return result;
}

}  // namespace streetview_localizer::detail
