#include "covariance.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "air_ground_common/units.h"
#include "cost_shape.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::kDegree;
using air_ground_common::Matrix6d;
using air_ground_common::Vector6d;
using air_ground_common::wrapAngle;

/// Covariance of (x, y, yaw) with `limit` as deviation along what the information leaves open.
Eigen::Matrix3d boundedInverse(const Eigen::Matrix3d& information, const Eigen::Vector3d& limit) {
  const Eigen::Matrix3d symmetric = 0.5 * (information + information.transpose());
  const Eigen::Matrix3d scaled = limit.asDiagonal() * symmetric * limit.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scaled);
  const Eigen::Vector3d variances = eigen.eigenvalues().cwiseMax(0.0).unaryExpr([](double v) { return 1 / (1 + v); });
  return limit.asDiagonal() * (eigen.eigenvectors() * variances.asDiagonal() * eigen.eigenvectors().transpose()) *
         limit.asDiagonal();
}

/// Carries an error of (x, y, yaw) over a lever [m].
Eigen::Matrix3d carriedBy(const Eigen::Vector2d& lever) {
  Eigen::Matrix3d carry = Eigen::Matrix3d::Identity();
  carry(0, 2) = -lever.y();
  carry(1, 2) = lever.x();
  return carry;
}

/// Of (x, y, yaw), from the shape of the cost. Residuals of variance C, `independent` of them: -log p = n C(u) /
/// (2 C_min), so that the information is n / (2 C_min) times the curvature of the cost.
Eigen::Matrix3d planarCovariance(const FoundPlace& place, const PlaceMeasures& measures, bool degenerate,
                                 const GroundModel& ground, double independent, const HeightMapLocalizerSettings& s) {
  const double cell = ground.map().resolution, extent = ground.extent();
  const Eigen::Matrix3d H =
      curvature(ground.direct(), place.cells, place.best, place.cost, {2 * cell, 2 * cell, 2 * kDegree});
  // A direction without curvature gets a limit as its deviation: the rival distance (or angle) where the verdict has
  // excluded more, else all that the ground map leaves open.
  const Eigen::Vector3d limit = degenerate ? Eigen::Vector3d(extent, extent, M_PI)
                                           : Eigen::Vector3d(s.rival.distance, s.rival.distance, s.rival.angle);
  Eigen::Matrix3d information = H * independent / (2 * (place.best.agreement.cost + s.noise_cost));
  // The curvature of a flat floor is that of its noise.
  if (measures.relief < s.verdict.min_relief) information.setZero();
  Eigen::Matrix3d planar = boundedInverse(information, limit);
  const Eigen::Vector3d& flattest = measures.flattest;
  if (!degenerate) {
    // Edges and noise bend the cost more just here than what stands does as far as the probe reaches.
    const double by_curvature = flattest.dot(planar.ldlt().solve(flattest)),
                 by_probe = independent * std::max(measures.probe_ratio - 1, 0.0);
    if (by_probe > 0 && by_probe < by_curvature)
      planar += (1 / by_probe - 1 / by_curvature) * flattest * flattest.transpose();
    return planar;
  }
  // The flattest direction changes the cost too little to be told from noise, whatever its curvature just here.
  const double reach =
      std::min(extent / std::max(flattest.head<2>().norm(), 1e-9), M_PI / std::max(std::abs(flattest.z()), 1e-9));
  const Eigen::Vector3d open = reach * flattest;
  planar += open * open.transpose();
  return planar;
}

}  // namespace

Matrix6d covarianceOf(const FoundPlace& place, const PlaceMeasures& measures, Status status, const GroundModel& ground,
                      const ParticleMode& particles, const Eigen::Vector2d& mav,
                      const HeightMapLocalizerSettings& settings) {
  if (status == Status::kSearching) return CoarseEstimate().covariance;
  const CovarianceSettings& s = settings.covariance;
  const Placement &best = place.best, &rival = place.rival;
  const double independent = independentMeasurements(best.agreement, settings);
  const Eigen::Matrix3d planar =
      planarCovariance(place, measures, status == Status::kDegenerate, ground, independent, settings);

  // The particles' own scatter, carried from the MAV to the centre of the overlap.
  const PlanarPose at_mav = changeReference(best.pose, place.cells.reference, mav);
  const Eigen::Matrix3d carry = carriedBy({best.pose.x - at_mav.x, best.pose.y - at_mav.y});
  const Eigen::Matrix3d scatter = carry * particles.covariance * carry.transpose();

  Matrix6d covariance = Matrix6d::Zero();
  const int index[3] = {0, 1, 5};
  const bool sharp = particles.weight > 0.9;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) covariance(index[i], index[j]) = planar(i, j) + (sharp ? 0.0 : scatter(i, j));
  }
  covariance(0, 0) += s.floor_position * s.floor_position;
  covariance(1, 1) += s.floor_position * s.floor_position;
  covariance(2, 2) = s.floor_z * s.floor_z + (best.agreement.cost + settings.noise_cost) / independent;
  covariance(3, 3) = covariance(4, 4) = 2 * s.gravity_sigma * s.gravity_sigma;
  covariance(5, 5) += s.floor_yaw * s.floor_yaw;
  if (status == Status::kAmbiguous) {
    // The truth may as well be over there.
    Vector6d way = Vector6d::Zero();
    way << rival.pose.x - best.pose.x, rival.pose.y - best.pose.y, rival.agreement.dz - best.agreement.dz, 0, 0,
        wrapAngle(rival.pose.yaw - best.pose.yaw);
    covariance += way * way.transpose();
  }
  return covariance;
}

}  // namespace heightmap_mcl
