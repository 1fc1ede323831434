#include "paper_estimate.h"

#include <algorithm>
#include <cmath>

namespace heightmap_mcl {

void estimateFromParticles(const HeightMap& map, const Eigen::Vector2d& mav, const DirectCost& direct,
                           const CostSettings& cost, const HeightMapLocalizerSettings& settings,
                           CoarseEstimate* estimate) {
  CoarseEstimate& e = *estimate;
  const AerialCells cells = aerialCells(map, mav);
  const Zmssd at_mean = direct(cells, e.particle_mean, cost);
  e.has_pose = std::isfinite(at_mean.cost);
  if (!e.has_pose) {
    e.reason = "the maps do not overlap at the particles' mean";
    return;
  }
  const PlanarPose origin = changeReference(e.particle_mean, mav, Eigen::Vector2d::Zero());
  e.T_ground_mav = air_ground_common::yawPose(origin.yaw, {origin.x, origin.y, at_mean.dz});
  e.cost = at_mean.cost;
  e.overlap = at_mean.overlap / static_cast<double>(cells.h.size());
  e.explained = at_mean.explained;
  e.relief = std::min(at_mean.relief_air, at_mean.relief_ground);
  e.reference_point = {e.particle_mean.x, e.particle_mean.y, cells.mean_height + at_mean.dz};
  const VerdictSettings& needed = settings.verdict;
  if (e.maps < needed.min_maps || e.particle_spread > needed.max_spread ||
      e.particle_spread_yaw > needed.max_spread_yaw) {
    e.reason = "the particles have not gathered yet";
    return;
  }
  e.status = Status::kConverged;
  e.reason = "the particles have gathered";
  const CovarianceSettings& s = settings.covariance;
  const double sigma = std::hypot(e.particle_spread, s.floor_position);
  const double sigma_yaw = std::hypot(e.particle_spread_yaw, s.floor_yaw);
  e.covariance.setZero();
  e.covariance.diagonal() << sigma * sigma, sigma * sigma, s.floor_z * s.floor_z + 2 * at_mean.cost,
      2 * s.gravity_sigma * s.gravity_sigma, 2 * s.gravity_sigma * s.gravity_sigma, sigma_yaw * sigma_yaw;
}

}  // namespace heightmap_mcl
