// The zero level set of the fused field: by ray casting from a view and as a cloud of the whole grid (paper A, section
// V).
#pragma once

#include <cstdint>
#include <vector>

#include "dense_fusion/depth_map.h"
#include "dense_fusion/histogram.h"
#include "dense_fusion/voxel_grid.h"

namespace dense_fusion {

struct SurfacePoint {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  ///< map frame [m]
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();    ///< unit length, towards free space
  std::uint8_t intensity = 0;                          ///< grey level of the view that shows it best
  std::uint8_t support = 0;                            ///< depth maps with a vote on the surface here
};

/// Per voxel: depth maps whose surface lies within the truncation band (all bins but the first and the last),
/// then the largest of these numbers within `fill_radius` voxels in x and y. Index order of VoxelGrid.
std::vector<std::uint8_t> surfaceSupport(const Histograms<std::uint8_t>& votes, int fill_radius, int threads);

struct SurfaceField {
  const VoxelGrid& grid;
  const std::vector<float>& phi;             ///< in [-1, 1], positive in free space
  const std::vector<std::uint8_t>& support;  ///< from surfaceSupport
  int min_support = 2;                       ///< crossings with fewer votes are the regulariser's invention: dropped
};

/// Depth of the first supported crossing from free space into matter along each pixel's ray; NaN where there is none.
/// `normals`, if given: CV_32FC3, map frame, towards free space, zero where depth is NaN.
cv::Mat castRays(const SurfaceField& field, const air_ground_common::CameraModel& camera,
                 const Eigen::Isometry3d& T_map_camera, int threads, cv::Mat* normals = nullptr);

/// All supported crossings on the grid's edges. Intensity is left at 0.
std::vector<SurfacePoint> extractSurface(const SurfaceField& field, int threads);

struct RefineSettings {
  double radius = 0.045;    ///< depth maps further than this from the surface have no say [m]
  double max_shift = 0.02;  ///< limit of the correction [m]
};

/// Weighted mean over the depth maps of (their depth - depth of the point), Tukey's weights times confidence: takes out
/// the rounding of distances to bins and voxels. 0 where fewer than two maps have a say.
double depthCorrection(const std::vector<DepthMap>& maps, const Eigen::Vector3d& point, const RefineSettings& settings);

/// Grey level of a surface point: from map `first` if it shows the point, else from the next that does; `fallback` if
/// none.
std::uint8_t intensityAt(const std::vector<DepthMap>& maps, std::size_t first, const Eigen::Vector3d& point,
                         double tolerance, std::uint8_t fallback);

}  // namespace dense_fusion
