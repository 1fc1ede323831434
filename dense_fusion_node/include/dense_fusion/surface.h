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
Field<std::uint8_t> surfaceSupport(const Histograms<std::uint8_t>& votes, int fill_radius, int threads);

struct SurfaceField {
  const VoxelGrid& grid;
  const Field<float>& phi;             ///< in [-1, 1], positive in free space
  const Field<std::uint8_t>& support;  ///< from surfaceSupport
  int min_support = 2;                 ///< crossings with fewer votes are the regulariser's invention: dropped
};

/// Depth of the first supported crossing from free space into matter along each pixel's ray; NaN where there is none.
/// `normals`, if given: CV_32FC3, map frame, towards free space, zero where depth is NaN.
cv::Mat castRays(const SurfaceField& field, const air_ground_common::CameraModel& camera,
                 const Eigen::Isometry3d& T_map_camera, int threads, cv::Mat* normals = nullptr);

/// All supported crossings on the grid's edges. Intensity is left at 0.
std::vector<SurfacePoint> extractSurface(const SurfaceField& field, int threads);

/// Depth maps ready to be asked about many points.
class DepthMapViews {
 public:
  struct Settings {
    double truncation = 0.08;  ///< depths nearer than this to a point speak of its surface [m]
    double radius = 0.06;      ///< depths further than this from a point do not move it [m]
    double max_shift = 0.02;   ///< limit of a correction [m]
    double agreement = 0.02;   ///< depths this near to the corrected point agree with it [m]
  };
  /// What the depth maps say about a point.
  struct Opinion {
    float shift = 0;  ///< along the depth of the asking view: Tukey's weights times confidence; 0 where fewer than two
                      ///< maps have a say. Takes out the rounding of distances to bins and voxels [m]
    int voices = 0;   ///< maps whose depth lies within the truncation
    float deviation = -1;  ///< standard deviation of a depth about the corrected point; -1: fewer than two speak [m]
    int agreeing = 0;      ///< maps whose depth agrees with the corrected point
    int seen_past = 0;     ///< maps that see further than the truncation behind it
    std::uint8_t intensity = 128;  ///< of the first map, counted from `first`, with a voice
  };

  /// The maps must outlive this.
  DepthMapViews(const std::vector<DepthMap>& maps, std::size_t first, const Settings& settings);
  Opinion ask(const Eigen::Vector3f& point) const;
  void setAgreement(double agreement) { settings_.agreement = agreement; }

 private:
  struct View {
    Eigen::Matrix3f R;  // camera from map
    Eigen::Vector3f t;
    float fx, fy, cx, cy;
    const DepthMap* map;
  };
  std::vector<View> views_;
  Settings settings_;
};

}  // namespace dense_fusion
