// From several depth maps to one regularised surface (paper A, sections V and VIII-B).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "dense_fusion/surface.h"
#include "dense_fusion/tv_l1.h"

namespace dense_fusion {

struct FusionSettings {
  double voxel_size = 0.02;           ///< [m]; grows when the scene would need more than max_voxels
  double voxel_pixels = 1.2;          ///< least edge of a voxel, in pixels of the depth maps at their median depth
  std::size_t max_voxels = 13536000;  ///< 376 x 240 x 150, the paper's grid; about 31 bytes each
  double truncation_voxels = 4;  ///< half width of the band around a surface in which a depth map votes for distances
  double behind_voxels = 4;      ///< further reach of its votes for matter: keeps the regulariser from erasing sheets
  int min_support = 2;           ///< depth maps that must agree within the band for a surface to be kept
  int min_agreeing = 2;  ///< depth maps that must agree with a point of the surface after its correction; 0: any point
  double agreement =
      1.0;              ///< they agree when their depth is this near [voxels], or within the deviation of such depths
  int fill_radius = 0;  ///< surfaces up to this many voxels beside supported ones are kept, too
  bool refine = true;   ///< sub-voxel correction by the mean of the depth maps that agree
  double extent_quantile = 0.003;  ///< share of the depths left out at each end when the grid is sized
  double sparse_margin = 0.5;      ///< room around the sparse points in view, beyond which the grid is cut [m]
  int min_sparse_points = 50;      ///< in view; fewer do not bound the grid
  TvL1Settings tv_l1;
  int threads = 2;
};

struct FusionTimings {
  double votes = 0, minimisation = 0, surface = 0;  ///< [s]
};

struct FusedMap {
  DepthMap depth_map;  ///< the surface seen from the reference view; confidence grows with the maps that agree
  std::vector<SurfacePoint> points;  ///< the whole surface in the grid
  VoxelGrid grid;
  int depth_maps = 0;       ///< fused
  double mean_support = 0;  ///< depth maps behind a surface point
  FusionTimings timings;
  std::int64_t newest_image = 0;  ///< stamp of the last image that was used [ns]
};

/// The box of the `sparse_points` (map frame, [m]) that lie in the view of any of the maps, with `sparse_margin` on all
/// sides, as far as the maps' depths reach (`extent_quantile` of them left out at each end of each axis), and room for
/// the band. With fewer than `min_sparse_points` in view the depths alone. Voxels are no finer than `voxel_pixels`.
/// Empty when the maps hold fewer than 100 depths, or none in the box.
std::optional<VoxelGrid> gridFor(const std::vector<DepthMap>& maps, const FusionSettings& settings,
                                 const std::vector<Eigen::Vector3f>& sparse_points);

/// Fuses the maps; `reference` is the index of the view to cast rays from. Empty when they hold too little depth.
/// Without `view` the depth map has no depth and no confidence, which saves the time of casting rays. Throws
/// std::invalid_argument for bad settings or an index out of range.
std::optional<FusedMap> fuseDepthMaps(const std::vector<DepthMap>& maps, std::size_t reference,
                                      const FusionSettings& settings,
                                      const std::vector<Eigen::Vector3f>& sparse_points = {}, bool view = true);

}  // namespace dense_fusion
