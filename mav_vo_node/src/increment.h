// Motion of base_link from one image to the next, with its covariance.
#pragma once

#include <vector>

#include "mav_vo/increment_covariance.h"
#include "mav_vo/odometry.h"

namespace mav_vo {

struct LocatedCamera {
  Pose T_map_camera;
  Matrix6d covariance;  ///< of the image noise
};

/// Since the image of `previous_stamp` [s]. Image noise of the two poses is independent; the map's error is common to
/// both and drops out.
Increment incrementBetween(double previous_stamp, const LocatedCamera& previous, const LocatedCamera& current,
                           const Pose& T_base_camera);

/// Puts the scatter of five-point solutions of `pairs` into its covariance. Where five points cannot tell (hovering,
/// turning on the spot, too few tracks) that of the poses stays. `sigma`: of a normalised coordinate.
void scatterCovariance(const std::vector<RayPair>& pairs, const Eigen::Matrix3d& R_map_base, const Pose& T_base_camera,
                       double sigma, const MonteCarloSettings& settings, Increment* increment);

/// The camera moves by `factor` times the step; the base's lever arm is metric already once the map is.
void scaleIncrement(double factor, const Pose& T_base_camera, Increment* increment);

}  // namespace mav_vo
