// Dense coloured cloud of the ground robot: filtered depth of keyframes, refined by the frames between, fused in
// voxels.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "air_ground_common/mesh.h"
#include "rgbd_slam/depth_model.h"
#include "visual_frontend/rolling_shutter.h"

namespace rgbd_slam {

struct CloudSettings {
  double voxel = 0.015;           ///< edge of the output voxels [m]
  int stride = 3;                 ///< every n-th pixel and row of the depth image, or less of a large one
  double max_range = 4.0;         ///< [m]
  double max_incidence = 1.35;    ///< angle between ray and surface normal; more grazing points are dropped [rad]
  int edge_margin = 2;            ///< pixels around depth edges that are dropped
  double gate = 3.0;              ///< frames agree with a keyframe's depth within this many sigmas
  int min_confirmations = 2;      ///< frames that must agree with a point (the keyframe's own counts)
  double min_weight_share = 0.1;  ///< of a point's voxel neighbourhood; fainter points (seen from far only) are dropped

  /// Throws std::invalid_argument, naming the field.
  void validate() const;
};

/// Depth of one keyframe on a coarser grid, averaged over the frames that follow it.
class KeyframeDepth {
 public:
  /// `depth`: CV_32F [m]; `bgr`: CV_8UC3 or CV_8UC1 of the same size. `rows`: of a rolling shutter.
  KeyframeDepth(const air_ground_common::CameraModel& camera, const cv::Mat& depth, const cv::Mat& bgr,
                const DepthModel& model, const CloudSettings& settings,
                const visual_frontend::RollingShutter* rows = nullptr);

  /// Averages in another frame's depth; T_frame_keyframe maps points of the keyframe's camera to the frame's.
  void fuse(const air_ground_common::CameraModel& camera, const cv::Mat& depth,
            const air_ground_common::Pose& T_frame_keyframe, const DepthModel& model, const CloudSettings& settings,
            const visual_frontend::RollingShutter* rows = nullptr);

  struct Point {
    Eigen::Vector3f position;  ///< keyframe camera frame [m]
    std::uint8_t bgr[3];
    float weight;  ///< 1 / variance of the depth [1/m^2]
  };
  /// Points confirmed often enough. `frames` that were fused limits what can be asked for.
  std::vector<Point> points(const DepthModel& model, const CloudSettings& settings) const;
  int frames() const { return frames_; }
  std::size_t cells() const { return cells_.size(); }

 private:
  struct Cell {
    float x, y;       ///< normalised ray
    float z, weight;  ///< running mean and its inverse variance, without the common part
    std::uint8_t bgr[3];
    std::uint8_t agree = 1, disagree = 0;
  };
  std::vector<Cell> cells_;
  int frames_ = 1;
};

struct DepthRays;  // hidden_space.h

using KeyframePoints = std::shared_ptr<const std::vector<KeyframeDepth::Point>>;

struct PosedPoints {
  air_ground_common::Pose T_map_camera;
  KeyframePoints points;
  int keyframe = -1;                                ///< tells the points from those of others as the map goes on
  std::shared_ptr<const DepthRays> rays = nullptr;  ///< of its depth image; null: not kept
};

struct CloudPoint {
  Eigen::Vector3f position;  ///< map [m]
  std::uint8_t bgr[3];
  float weight;  ///< 1 / variance [1/m^2]
};

/// One point a voxel: mean of positions and colours weighted by inverse variance. A function of its arguments alone, in
/// ascending order of the voxels, so that it can run on any thread.
std::vector<CloudPoint> fusePoints(const std::vector<PosedPoints>& keyframes, const CloudSettings& settings);

/// fusePoints for a map that grows: each update fuses only the keyframes that are new, have other points, or have moved
/// by more than a share of a voxel, and looks again only at the voxels around theirs.
class GroundCloud {
 public:
  /// `tolerance`: a keyframe keeps its place in the cloud until a point of it would move by more than this share of a
  /// voxel; 0: every change counts. Throws std::invalid_argument.
  explicit GroundCloud(const CloudSettings& settings, double tolerance = 0.2);
  ~GroundCloud();
  GroundCloud(GroundCloud&&) noexcept;
  GroundCloud& operator=(GroundCloud&&) noexcept;

  /// All keyframes as they stand now, each with its number; those missing are taken out. Returns how many were fused.
  int update(const std::vector<PosedPoints>& keyframes);

  /// One point a voxel, in the order of fusePoints.
  std::vector<CloudPoint> points() const;

  void clear();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rgbd_slam
