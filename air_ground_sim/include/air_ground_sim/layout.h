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

/// A rectangle on the floor or on top of something, and what may still stand on it.
struct Footprint {
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  double yaw = 0, hx = 0, hy = 0;  ///< half sizes [m]
  double top = 0;                  ///< [m]
  bool can_carry = true;
};

/// Whether two footprints come nearer than `gap` [m].
bool overlap(const Footprint& a, const Footprint& b, double gap);

/// Base of what stands on the footprint at height z [m].
air_ground_common::Pose standing(const Footprint& f, double z);

/// A box of one of eight sizes, varied.
Cuboid randomBox(Rng* rng);

/// A finely textured centre and four coarser strips around it.
void addFloor(const WorldConfig& config, std::uint64_t seed, World* world);
/// Outer walls at the floor's edge.
void addRoom(const WorldConfig& config, std::uint64_t seed, World* world);
void addClusters(const std::vector<ClusterConfig>& clusters, const FreeSpace& free, double texel, Rng* rng,
                 World* world);
void addWall(const WallConfig& wall, double texel, std::uint64_t seed, World* world);
void addGrid(const WorldConfig& config, World* world);
/// Height field, rocks and broken slabs.
void addRubble(const WorldConfig& config, const FreeSpace& free, Rng* rng, World* world);

}  // namespace air_ground_sim
