// Covariances of poses (x y z [m], rotX rotY rotZ [rad]: errors of the translation and of the rotation vector about the
// axes of the frame that the pose is in, p' = exp(rot) p), carried to other points, axes and units.
#pragma once

#include "air_ground_common/geometry.h"

namespace air_ground_common {

/// Of another point of the same rigid body, which `lever` [m] leads to: d(p + lever) = dp + rot x lever.
Matrix6d covarianceAt(const Matrix6d& covariance, const Eigen::Vector3d& lever);

/// In the frame, and the unit, of p_new = scale R p_old + t.
Matrix6d transformed(const Matrix6d& covariance, const Similarity& S_new_old);

/// About the axes of another frame, which R_new_old turns into.
Matrix6d aboutAxes(const Eigen::Matrix3d& R_new_old, const Matrix6d& covariance);

/// Of a pose at `position` in a map that leans by `sigma` [rad] about its origin's horizontal axes.
Matrix6d tiltCovariance(double sigma, const Eigen::Vector3d& position);

/// Standard deviation along the worst direction; 0 where rounding has made a covariance of nearly nothing negative.
double largestStddev(const Eigen::Matrix3d& covariance);

}  // namespace air_ground_common
