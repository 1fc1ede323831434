#include "icp_refine/known_alignment.h"

#include <Eigen/Cholesky>

#include "air_ground_common/covariance.h"

namespace icp_refine {
namespace {

/// Projects on the directions of the pose that the geometry does not fix: translation [m], rotation [rad].
Matrix6d missingDirections(const Localizability& localizability) {
  Vector6d unit = Vector6d::Ones();
  unit.tail<3>() /= std::max(localizability.mean_range, 1e-3);
  Matrix6d P = Matrix6d::Zero();
  for (const Direction& d : localizability.directions)
    if (!d.localizable) P += unit.asDiagonal() * d.v * d.v.transpose() * unit.cwiseInverse().asDiagonal();
  return P;
}

/// Translation [m] and rotation [rad] about ICP's centre.
Vector6d difference(const KnownAlignment& known, const IcpResult& icp) {
  const Eigen::Vector3d p_mav = inverse(icp.T_reference_reading) * icp.centre;
  Vector6d d;
  d << icp.centre - known.T_ground_map_mav_map * p_mav,
      air_ground_common::logSO3(icp.T_reference_reading.R * known.T_ground_map_mav_map.R.transpose());
  return d;
}

}  // namespace

Pose alignmentFrom(const Pose& T_ground_map_base, const Pose& T_mav_map_base) {
  const double yaw =
      air_ground_common::yawOf(T_ground_map_base.linear()) - air_ground_common::yawOf(T_mav_map_base.linear());
  const Pose turn = air_ground_common::yawPose(yaw, Eigen::Vector3d::Zero());
  return air_ground_common::yawPose(yaw, T_ground_map_base.translation() - turn * T_mav_map_base.translation());
}

double positionStddev(const Matrix6d& covariance) {
  return air_ground_common::largestStddev(covariance.topLeftCorner<3, 3>());
}

Matrix6d covarianceAbout(const KnownAlignment& known, const Eigen::Vector3d& point) {
  const Eigen::Vector3d lever = point - known.centre;
  Matrix6d out = air_ground_common::covarianceAt(known.covariance, lever);
  out.topLeftCorner<3, 3>() += known.scale_stddev * known.scale_stddev * lever * lever.transpose();
  return out;
}

Similarity heldAt(const KnownAlignment& known, const IcpResult& icp) {
  const Vector6d d = missingDirections(icp.localizability) * difference(known, icp);
  const Eigen::Vector3d p_mav = inverse(icp.T_reference_reading) * icp.centre;
  Similarity T = icp.T_reference_reading;
  T.R = air_ground_common::expSO3(-d.tail<3>()) * T.R;
  T.t = icp.centre - d.head<3>() - T.scale * (T.R * p_mav);
  return T;
}

Matrix6d heldBy(const KnownAlignment& known, const IcpResult& icp) {
  const Matrix6d missing = missingDirections(icp.localizability), fixed = Matrix6d::Identity() - missing;
  return fixed * icp.covariance.topLeftCorner<6, 6>() * fixed.transpose() +
         missing * covarianceAbout(known, icp.centre) * missing.transpose();
}

double squaredSigmas(const KnownAlignment& known, const IcpResult& icp) {
  const Vector6d d = difference(known, icp);
  const Matrix6d covariance = covarianceAbout(known, icp.centre) + heldBy(known, icp);
  return d.dot(covariance.ldlt().solve(d));
}

double squaredSigmasOfMissing(const KnownAlignment& known, const IcpResult& icp) {
  const Matrix6d missing = missingDirections(icp.localizability), C = covarianceAbout(known, icp.centre);
  // Directions that are fixed count for nothing: a variance of their own, and no difference.
  const Matrix6d fixed = Matrix6d::Identity() - missing;
  const Vector6d d = missing * difference(known, icp);
  return d.dot((missing * C * missing.transpose() + fixed * C * fixed.transpose()).ldlt().solve(d));
}

bool isNearAlongOpen(const KnownAlignment& known, const IcpResult& icp) {
  constexpr double kMoved = 7.8;
  return icp.localizability.complete() || squaredSigmasOfMissing(known, icp) < kMoved;
}

}  // namespace icp_refine
