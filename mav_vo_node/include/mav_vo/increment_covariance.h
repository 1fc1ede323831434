// Covariance of a visual-odometry increment by Monte Carlo over minimal samples (paper B, III.B): five correspondences
// at a time through the five-point problem (Nister 2004), a thousand times.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"

namespace mav_vo {

using air_ground_common::Pose;

/// One point in two images: undistorted x/z, y/z.
struct RayPair {
  Eigen::Vector2d previous = Eigen::Vector2d::Zero();
  Eigen::Vector2d current = Eigen::Vector2d::Zero();
};

/// Solutions of five-point problems, each the root to which Newton's method leads from one starting motion.
struct FivePointSolutions {
  std::vector<Eigen::Matrix3d> R_previous_current;
  std::vector<Eigen::Vector3d> t_previous_current;  ///< unit length
  std::vector<unsigned char> converged;             ///< 0: no root was reached, the other entries mean nothing
};

/// `samples` holds five indices into `pairs` for each problem. The five epipolar constraints p . (t x R c) = 0 in the
/// five unknowns (rotation, direction of t) are solved by Newton's method from `start` (any length of translation > 0;
/// a rotation by at most a few tenths of a radian from the solution): the root nearest in that sense of up to ten.
/// Eight problems at a time.
FivePointSolutions solveFivePoint(const std::vector<RayPair>& pairs, const std::vector<int>& samples,
                                  const Pose& start_previous_current);

struct MonteCarloSettings {
  int samples = 1000;
  double min_parallax = 3.0;   ///< median turn-free displacement, below: degenerate [pixel_sigma]
  double min_converged = 0.5;  ///< share of the samples that must give a root
  unsigned seed = 1;
};

struct MonteCarloCovariance {
  bool success = false;
  std::string reason;  ///< why not; empty on success
  Eigen::Matrix4d covariance =
      Eigen::Matrix4d::Zero();  ///< (x, y, z, yaw) in the earlier base_link [m^2, m rad, rad^2]
  int converged = 0;            ///< samples that gave a root
};

/// Scatter of the increment T_base_previous_current. Five points give the translation's direction; its length is the
/// odometry's, with `length_variance` [m^2] along it. Yaw is the rotation about the map's vertical: R_map_base of the
/// earlier pose. Fails for fewer than 8 pairs, motion without parallax, or too few roots. `sigma` of a normalised
/// coordinate.
MonteCarloCovariance monteCarloIncrement(const std::vector<RayPair>& pairs, const Pose& T_base_previous_current,
                                         const Pose& T_base_camera, const Eigen::Matrix3d& R_map_base,
                                         double length_variance, double sigma, const MonteCarloSettings& settings);

}  // namespace mav_vo
