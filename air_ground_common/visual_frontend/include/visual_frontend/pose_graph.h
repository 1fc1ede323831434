// Pose-graph optimisation for loop closure (Ceres).
#pragma once

#include <string>
#include <vector>

#include "visual_frontend/map.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct PoseGraphNode {
  Pose T_map_camera = Pose::Identity();
  bool fixed = false;
};

struct PoseGraphEdge {
  int a = 0, b = 0;               ///< nodes
  Pose T_a_b = Pose::Identity();  ///< measured
  /// Covariance of (translation, rotation vector) of T_a_b, perturbed as T_a_b * exp; positive definite.
  Matrix6d covariance = Matrix6d::Identity();
  bool robust = false;  ///< Cauchy loss: loop edges
};

struct PoseGraphSettings {
  bool four_dof = false;  ///< only position and rotation about the map's z (roll and pitch known from gravity)
  int max_iterations = 50;
};

struct PoseGraphResult {
  bool usable = false;
  std::string message;
  double initial_cost = 0, final_cost = 0;
  int iterations = 0;
};

/// Throws std::invalid_argument for indices out of range, a covariance that is not positive definite, or no fixed node.
PoseGraphResult optimizePoseGraph(std::vector<PoseGraphNode>& nodes, const std::vector<PoseGraphEdge>& edges,
                                  const PoseGraphSettings& settings);

struct LoopEdge {
  KeyframeId a = kNoKeyframe, b = kNoKeyframe;
  Pose T_a_b = Pose::Identity();
  Matrix6d covariance = Matrix6d::Identity();
};

/// Pose graph over the map: consecutive keyframes and covisible ones (at least `min_shared` landmarks) with their
/// present relative poses, plus loop edges. Corrects keyframes and carries landmarks along with their first observer.
/// `fixed`: held (the oldest when kNoKeyframe).
PoseGraphResult closeLoops(Map& map, const std::vector<LoopEdge>& loops, int min_shared, KeyframeId fixed,
                           const PoseGraphSettings& settings);

}  // namespace visual_frontend
