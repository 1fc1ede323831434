// Surfaces that a depth image shows, and how those of two images lie upon each other: what depth alone tells of the
// camera's motion, whatever the images' texture, light and calibration (point-to-plane: Chen and Medioni 1992;
// projective association: Blais and Levine 1995, Newcombe et al. 2011).
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "rgbd_slam/depth_model.h"
#include "visual_frontend/rolling_shutter.h"

namespace rgbd_slam {

/// A depth image in square cells of some pixels, each with its mean depth and the surface's normal.
class DepthSurface {
 public:
  struct Cell {
    Eigen::Vector3f position;  ///< camera frame, as of the middle row [m]
    Eigen::Vector3f normal;    ///< unit, towards the camera
    float sigma;               ///< of the depth [m]; 0: the cell shows no surface
  };

  /// `depth`: CV_32F of the camera's size [m], NaN or <= 0 = unknown. `rows`: of a rolling shutter. Throws
  /// std::invalid_argument for another type or size.
  DepthSurface(const air_ground_common::CameraModel& camera, const cv::Mat& depth, const DepthModel& model,
               const visual_frontend::RollingShutter& rows);

  const std::vector<Cell>& cells() const { return cells_; }
  std::size_t known() const { return known_; }  ///< cells that show a surface

  /// What a cell covers of its surface [m^2].
  double area(const air_ground_common::CameraModel& camera, const Cell& cell) const;

  /// With a readout time that is longer by that of `shift`: each cell moves to where the middle row sees it.
  void moveRows(const visual_frontend::RollingShutter& shift);

  /// The same pixels and depths by a better calibration.
  void recalibrate(const air_ground_common::CameraModel& before, const air_ground_common::CameraModel& better_known);

  /// The cell that a point of the camera frame falls into; null: none that shows a surface.
  const Cell* seenAt(const air_ground_common::CameraModel& camera, const Eigen::Vector3d& p_camera) const;

 private:
  const Cell& cell(int column, int row) const { return cells_[static_cast<std::size_t>(row) * columns_ + column]; }
  double rowOfPixels(int row) const { return row * edge_ + 0.5 * (edge_ - 1); }  ///< in the middle of a row of cells

  int columns_ = 0, rows_ = 0, edge_ = 1;
  std::vector<Cell> cells_;
  std::size_t known_ = 0;
};

struct SurfaceAlignmentSettings {
  int max_iterations = 20;
  double max_distance = 0.1;  ///< between surfaces that are taken for the same, at first [m]
  double min_overlap = 0.3;   ///< share of the smaller surface's cells that must lie upon the other
  double min_normal = 0.06;   ///< root mean square of the normals along a direction that they are taken to fix [1]
  double dependence = 4;      ///< neighbouring cells err alike: so many count as one
  double floor_sigma = 1e-3;  ///< of the translation that no number of cells goes below [m]
  double floor_angle = 5e-4;  ///< likewise of the rotation [rad]
};

struct SurfaceAlignment {
  bool success = false;
  std::string reason;  ///< why not
  air_ground_common::Pose T_a_b = air_ground_common::Pose::Identity();
  /// Of (translation, rotation) of a perturbation d in T_a_b * exp(d): singular along what the surfaces leave open,
  /// where T_a_b is as it was at the start.
  air_ground_common::Matrix6d information = air_ground_common::Matrix6d::Zero();
  double overlap = 0;  ///< share of the smaller surface's cells that lie upon the other
  double rms = 0;      ///< of their distances [sigma]
};

/// Least squares over the distances of b's cells to a's planes, from `T_a_b_start`, with Tukey's loss.
SurfaceAlignment alignSurfaces(const air_ground_common::CameraModel& camera, const DepthSurface& a,
                               const DepthSurface& b, const air_ground_common::Pose& T_a_b_start,
                               const SurfaceAlignmentSettings& settings = {});

}  // namespace rgbd_slam
