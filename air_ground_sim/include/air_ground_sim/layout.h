// Obstacles of the worlds: which box stands where. Used by buildWorld.
#pragma once

#include "air_ground_sim/random.h"
#include "air_ground_sim/world.h"

namespace air_ground_sim {

/// Places that must stay free: the ground robot's lane and the take-off place.
struct FreeSpace {
  std::vector<Eigen::Vector2d> lane;  ///< dense points [m]
  double lane_half_width = 0.4;       ///< [m]
  Eigen::Vector2d start = Eigen::Vector2d::Zero();
  double start_radius = 0.5;  ///< [m]
  bool isFree(const Eigen::Vector2d& center, double reach) const;
};

void addClusters(const std::vector<ClusterConfig>& clusters, const FreeSpace& free, double texel, Rng* rng,
                 World* world);
void addWall(const WallConfig& wall, double texel, std::uint64_t seed, World* world);
void addGrid(const WorldConfig& config, World* world);
/// Height field, rocks and broken slabs.
void addRubble(const WorldConfig& config, const FreeSpace& free, Rng* rng, World* world);

}  // namespace air_ground_sim
