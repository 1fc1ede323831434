// Several database views that see one point fix it better than the city model does: a wall of the model is a plane, the
// facade has window reveals, cornices and balconies. Fuses the views' rays with the model and refines the pose on the
// result.
#pragma once

#include <vector>

#include "streetview_localizer/pose_estimation.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct PointFusionSettings {
  double surface_stddev = 0.4;  ///< of the facade about the model's wall, along the wall's normal [m]
  double pixel_stddev = 1.0;    ///< of a keypoint, in a view and in the query, one axis [px]
  int max_iterations = 30;

  /// Throws std::invalid_argument, naming the field, when a value cannot work.
  void validate() const;
};

/// The view that a correspondence was found in.
struct ViewRay {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< optical centre of the view in world [m]
  double pixel_angle = 0.001;                        ///< of one pixel of the view [rad]
  double centre_stddev = 0;                          ///< of the view's position, one axis [m]
};

/// A point of the facade seen at one pixel of the query.
struct FusedPoint {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();       ///< in the query [px]
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();     ///< [m]
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< [m^2]
  int sightings = 0;                                     ///< correspondences behind it
};

/// One point a query pixel, from the correspondences listed in `use`. With n the wall's normal, p_0 the point on the
/// model, and for each sighting i the ray d_i through p_i with lateral deviation s_i:
///   A = n n^T / surface_stddev^2 + sum_i (I - d_i d_i^T) / s_i^2,   A p = n n^T p_0 / surface_stddev^2 + sum_i (I -
///   d_i d_i^T) p_i / s_i^2,
/// covariance A^-1. Correspondences without normal are taken to face their view. In order of the first sighting.
/// Throws std::invalid_argument when sizes differ or an index is out of range.
std::vector<FusedPoint> fusePoints(const std::vector<Correspondence>& correspondences, const std::vector<ViewRay>& rays,
                                   const std::vector<int>& use, const PointFusionSettings& settings);

struct FusedRefinement {
  bool converged = false;
  Pose T_world_camera = Pose::Identity();
  Matrix6d covariance =
      Matrix6d::Zero();  ///< in the order and frame of PoseResult::covariance; image and surface noise
  int points = 0;
};

/// Minimises sum_i rho(r_i^T S_i^-1 r_i), S_i = pixel_stddev^2 I + J_i C_i J_i^T with C_i the point's covariance, J_i
/// the Jacobian of its pixel, rho Cauchy's (scale 2), by Levenberg-Marquardt from `start`; gravity as in estimatePose.
FusedRefinement refineOnFusedPoints(const std::vector<FusedPoint>& points, const CameraModel& camera,
                                    const PosePrior& prior, const Pose& start, const PointFusionSettings& settings);

}  // namespace streetview_localizer
