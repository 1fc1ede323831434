// Gravity-aligned voxel grid (the domain Omega of paper A, section V) and the rule for its size.
#pragma once

#include <Eigen/Core>
#include <cstddef>

namespace dense_fusion {

/// Voxel (x, y, z) has its centre at origin + voxel_size * (x, y, z). Linear index: (z * ny + y) * nx + x.
struct VoxelGrid {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< centre of voxel (0, 0, 0) in the map frame [m]
  double voxel_size = 0.015;                         ///< [m]
  int nx = 0, ny = 0, nz = 0;

  std::size_t voxels() const { return static_cast<std::size_t>(nx) * ny * nz; }
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * ny + y) * nx + x; }
  Eigen::Vector3d center(int x, int y, int z) const { return origin + voxel_size * Eigen::Vector3d(x, y, z); }
};

/// Grid over the box [lower, upper] [m] with voxels of at least `voxel_size` [m]; they grow (in all directions alike)
/// until no more than `max_voxels` are needed. Throws std::invalid_argument for an empty or non-finite box.
VoxelGrid fitGrid(const Eigen::Vector3d& lower, const Eigen::Vector3d& upper, double voxel_size,
                  std::size_t max_voxels);

}  // namespace dense_fusion
