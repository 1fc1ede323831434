#include "dense_fusion/voxel_grid.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace dense_fusion {

VoxelGrid fitGrid(const Eigen::Vector3d& lower, const Eigen::Vector3d& upper, double voxel_size,
                  std::size_t max_voxels) {
  if (!lower.allFinite() || !upper.allFinite() || !(upper.array() > lower.array()).all())
    throw std::invalid_argument("voxel grid: the box to cover is empty or not finite");
  if (!(voxel_size > 0) || max_voxels < 1000)
    throw std::invalid_argument("voxel grid: voxel_size must be positive and max_voxels at least 1000");
  const Eigen::Vector3d extent = upper - lower;
  VoxelGrid grid;
  grid.voxel_size = voxel_size;
  for (;;) {
    const Eigen::Vector3d n = (extent / grid.voxel_size).array().ceil() + 1;
    if (n.prod() <= static_cast<double>(max_voxels)) {
      grid.nx = static_cast<int>(n.x());
      grid.ny = static_cast<int>(n.y());
      grid.nz = static_cast<int>(n.z());
      break;
    }
    grid.voxel_size *= std::max(1.01, std::cbrt(n.prod() / static_cast<double>(max_voxels)));
  }
  grid.origin = lower;
  return grid;
}

}  // namespace dense_fusion
