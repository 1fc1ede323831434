// Scenes for tests: boxes on a floor, seen by a depth camera that drives around them and by a camera that flies over
// them.
#pragma once

#include <random>
#include <string>

#include "air_ground_common/mesh.h"
#include "icp_refine/cloud.h"

namespace icp_refine::synthetic {

enum class World { kBoxes, kFlat, kCorridor };

struct SceneSettings {
  World world = World::kBoxes;
  int boxes = 11;
  double scale_error = 0.01;    ///< relative error of the aerial map's scale (standard deviation)
  double scale_offset = 0;      ///< the same, given
  double aerial_noise = 0.012;  ///< independent, along the ray [m]
  double aerial_bumps = 0.012;  ///< correlated over about 0.3 m [m]
  double missing = 0.25;        ///< share of aerial patches without depth
  double ground_drift = 0.01;   ///< drift of the ground robot's poses [m per m]
  bool smooth_edges = true;     ///< aerial depth is averaged over 3x3 pixels: faces get skirts
};

struct Scene {
  air_ground_common::TriangleMesh mesh;  ///< world frame, floor at z = 0
  Cloud ground;                          ///< ground_map frame [m]
  Cloud aerial;                          ///< mav_map frame [m]
  Similarity truth;                      ///< T_ground_map_mav_map
  Pose T_ground_map_mav_map;             ///< the same, its scale taken as 1 at the middle of the aerial cloud
  Pose T_world_ground_map, T_world_mav_map;
};

/// Deterministic for a seed.
Scene makeScene(unsigned seed, const SceneSettings& settings = {});

/// T with noise: rotation about a random axis of N(0, sigma_angle) (or about z only), translation of N(0, sigma) an
/// axis in a random direction, at the point `centre` of the reading.
Pose perturbed(const Pose& T, const Eigen::Vector3d& centre, double sigma_translation, double sigma_angle,
               bool yaw_only, std::mt19937& rng);

/// Mean of the points.
Eigen::Vector3d centroid(const Cloud& cloud);

}  // namespace icp_refine::synthetic
