// What another stage tells of the alignment (by the robots' images, or by height maps): a start for ICP, and what the
// clouds' geometry leaves open.
#pragma once

#include "icp_refine/icp.h"

namespace icp_refine {

struct KnownAlignment {
  Similarity T_ground_map_mav_map;
  Matrix6d covariance = Matrix6d::Identity();        ///< translation [m], rotation [rad] about `centre`
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< in the ground map [m]
  double scale_stddev = 0.05;                        ///< relative
  bool tells_scale = false;                          ///< of a map that has none: a prior for the clouds
};

/// Both maps hang from gravity: heading and place of one body in both fix the MAV's map in the ground robot's.
Pose alignmentFrom(const Pose& T_ground_map_base, const Pose& T_mav_map_base);

/// Of the position, in any direction [m].
double positionStddev(const Matrix6d& covariance);

/// Its covariance about another point of the ground map: a turn about `centre` moves that point, and so does the scale.
Matrix6d covarianceAbout(const KnownAlignment& known, const Eigen::Vector3d& point);

/// How far ICP's result lies from it, about ICP's centre, in sigmas of both: 6 degrees of freedom. Directions that the
/// geometry does not fix count with what is known alone.
double squaredSigmas(const KnownAlignment& known, const IcpResult& icp);

/// How far ICP's result has moved from it along the directions that the geometry does not fix, in its sigmas alone.
double squaredSigmasOfMissing(const KnownAlignment& known, const IcpResult& icp);

/// That it has not moved farther than 95 % of right ones would: with three degrees of freedom, those of height maps.
bool isNearAlongOpen(const KnownAlignment& known, const IcpResult& icp);

/// ICP's result, moved along these directions to where they are known. To first order no residual changes.
Similarity heldAt(const KnownAlignment& known, const IcpResult& icp);

/// ICP's covariance of the pose, where the directions that the geometry does not fix are as it is known.
Matrix6d heldBy(const KnownAlignment& known, const IcpResult& icp);

}  // namespace icp_refine
