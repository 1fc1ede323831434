#include "visual_frontend/pose_graph.h"

#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <set>
#include <stdexcept>
#include <unordered_map>

#include "air_ground_common/linear_algebra.h"
#include "visual_frontend/ceres_costs.h"

namespace visual_frontend {

namespace {

template <int N>
PoseGraphResult optimize(std::vector<PoseGraphNode>& nodes, const std::vector<PoseGraphEdge>& edges,
                         int max_iterations) {
  using State = Eigen::Matrix<double, N, 1>;
  std::vector<State, Eigen::aligned_allocator<State>> state(nodes.size(), State::Zero());
  for (std::size_t i = 0; i < nodes.size(); ++i) state[i].template head<3>() = nodes[i].T_map_camera.translation();
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(options);
  ceres::CauchyLoss robust(5.0);  // wide: drift may well exceed what its covariance admits
  for (const PoseGraphEdge& e : edges) {
    const Eigen::LLT<Matrix6d> llt(air_ground_common::inverse(e.covariance));
    if (llt.info() != Eigen::Success || !llt.matrixL().toDenseMatrix().allFinite()) {
      throw std::invalid_argument("optimizePoseGraph: an edge's covariance is not positive definite");
    }
    const Matrix6d sqrt_information = llt.matrixU();
    problem.AddResidualBlock(new RelativePoseCost<N>(nodes[e.a].T_map_camera.linear(), nodes[e.b].T_map_camera.linear(),
                                                     e.T_a_b, sqrt_information),
                             e.robust ? &robust : nullptr, state[e.a].data(), state[e.b].data());
  }
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (nodes[i].fixed && problem.HasParameterBlock(state[i].data()))
      problem.SetParameterBlockConstant(state[i].data());
  }
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  solver.max_num_iterations = max_iterations;
  solver.function_tolerance = 1e-8;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  PoseGraphResult result;
  result.usable = summary.IsSolutionUsable();
  result.message = summary.message;
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.iterations = static_cast<int>(summary.iterations.size());
  if (!result.usable) return result;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (nodes[i].fixed) continue;
    const CameraState<N> s(state[i].data(), nodes[i].T_map_camera.linear());
    nodes[i].T_map_camera.translation() = s.c;
    nodes[i].T_map_camera.linear() = s.R;
    nodes[i].T_map_camera = air_ground_common::normalized(nodes[i].T_map_camera);
  }
  return result;
}

}  // namespace

PoseGraphResult optimizePoseGraph(std::vector<PoseGraphNode>& nodes, const std::vector<PoseGraphEdge>& edges,
                                  const PoseGraphSettings& settings) {
  const int n = static_cast<int>(nodes.size());
  for (const PoseGraphEdge& e : edges) {
    if (e.a < 0 || e.a >= n || e.b < 0 || e.b >= n || e.a == e.b)
      throw std::invalid_argument("optimizePoseGraph: an edge's node is out of range");
    if (!e.covariance.allFinite() || !air_ground_common::isValid(e.T_a_b))
      throw std::invalid_argument("optimizePoseGraph: an edge is not finite");
  }
  if (std::none_of(nodes.begin(), nodes.end(), [](const PoseGraphNode& x) { return x.fixed; })) {
    throw std::invalid_argument("optimizePoseGraph: fix at least one node, the graph floats otherwise");
  }
  return settings.four_dof ? optimize<4>(nodes, edges, settings.max_iterations)
                           : optimize<6>(nodes, edges, settings.max_iterations);
}

PoseGraphResult closeLoops(Map& map, const std::vector<LoopEdge>& loops, int min_shared, KeyframeId fixed,
                           const PoseGraphSettings& settings) {
  std::vector<PoseGraphNode> nodes;
  std::vector<KeyframeId> ids;
  std::unordered_map<KeyframeId, int> index;
  for (const auto& [id, keyframe] : map.keyframes()) {
    index[id] = static_cast<int>(nodes.size());
    ids.push_back(id);
    PoseGraphNode node;
    node.T_map_camera = keyframe.T_map_camera;
    node.fixed = fixed == kNoKeyframe ? nodes.empty() : id == fixed;
    nodes.push_back(node);
  }
  std::vector<PoseGraphEdge> edges;
  std::set<std::pair<int, int>> present;
  const auto addEdge = [&](int a, int b, int shared) {
    if (!present.insert({std::min(a, b), std::max(a, b)}).second) return;
    PoseGraphEdge edge;
    edge.a = a;
    edge.b = b;
    edge.T_a_b = nodes[a].T_map_camera.inverse() * nodes[b].T_map_camera;
    // Tracking errs by a percent of the way, and less where many landmarks tie the two.
    const double trust = std::sqrt(50.0 / std::max(shared, 10));
    const double translation = trust * (0.005 + 0.01 * edge.T_a_b.translation().norm());
    edge.covariance.topLeftCorner<3, 3>().diagonal().setConstant(translation * translation);
    edge.covariance.bottomRightCorner<3, 3>().diagonal().setConstant(trust * trust * 0.004 * 0.004);
    edges.push_back(edge);
  };
  for (const KeyframeId id : ids) {
    const int i = index[id];
    for (const Map::Covisible& c : map.covisible(id, min_shared))
      addEdge(std::min(i, index[c.keyframe]), std::max(i, index[c.keyframe]), c.shared);
  }
  for (int i = 1; i < static_cast<int>(nodes.size()); ++i) addEdge(i - 1, i, 10);
  for (const LoopEdge& loop : loops) {
    PoseGraphEdge edge;
    edge.a = index.at(loop.a);
    edge.b = index.at(loop.b);
    edge.T_a_b = loop.T_a_b;
    edge.covariance = loop.covariance;
    edge.robust = true;
    edges.push_back(edge);
  }
  PoseGraphResult result = optimizePoseGraph(nodes, edges, settings);
  if (!result.usable) return result;
  std::unordered_map<KeyframeId, Pose> T_new_old;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    T_new_old[ids[i]] = nodes[i].T_map_camera * map.keyframe(ids[i]).T_map_camera.inverse();
    map.keyframe(ids[i]).T_map_camera = nodes[i].T_map_camera;
  }
  for (const LandmarkId id : map.landmarkIds()) {
    Landmark& landmark = map.landmark(id);
    if (!landmark.observations.empty())
      landmark.position = T_new_old.at(landmark.observations.front().keyframe) * landmark.position;
  }
  return result;
}

}  // namespace visual_frontend
