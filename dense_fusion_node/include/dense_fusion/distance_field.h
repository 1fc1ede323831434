// Votes of depth maps on the voxel grid: truncated signed distances, one histogram a voxel (paper A, section V; Zach
// 2008).
#pragma once

#include "dense_fusion/depth_map.h"
#include "dense_fusion/histogram.h"
#include "dense_fusion/voxel_grid.h"

namespace dense_fusion {

/// Reach of a depth map's votes along its rays.
struct VoteBand {
  double truncation = 0.06;  ///< distance at which f reaches +1 or -1 [m]
  double behind =
      0;  ///< f = -1 is voted this far beyond the truncation behind the surface; nothing is known further on [m]
};

/// Distance field f of one depth map at a point [m, map frame]: ((depth at the point's pixel) - (depth of the point)) /
/// truncation. +1 (clamped) in free space before the surface, 0 on it, -1 behind; NaN where the map says nothing:
/// outside the view, at pixels without depth, and further behind the surface than the band reaches.
float distanceAt(const DepthMap& map, const Eigen::Vector3d& point, const VoteBand& band);

/// Adds one vote of the map to each voxel it says something about: the bin whose centre is nearest to f.
/// Throws std::invalid_argument when grid and histograms differ in size.
void addVotes(const DepthMap& map, const VoxelGrid& grid, const VoteBand& band, int threads,
              Histograms<std::uint8_t>* votes);

/// The same by distanceAt, voxel by voxel.
void addVotesReference(const DepthMap& map, const VoxelGrid& grid, const VoteBand& band,
                       Histograms<std::uint8_t>* votes);

}  // namespace dense_fusion
