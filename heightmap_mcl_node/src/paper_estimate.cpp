// The estimate as in Forster 2013: the mean of the particles, believed where they have gathered.
#include <algorithm>
#include <cmath>

#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

void HeightMapLocalizer::estimateFromParticles() {
  CoarseEstimate& e = estimate_;
  const AerialCells cells = aerialCells(filter_map_, filter_.reference());
  const Zmssd at_mean = (*direct_)(cells, e.particle_mean, costFor(filter_map_));
  if (weighed_) filter_.resample(nullptr, prior_);
  weighed_ = false;
  e.has_pose = std::isfinite(at_mean.cost);
  if (!e.has_pose) {
    e.reason = "the maps do not overlap at the particles' mean";
    return;
  }
  const PlanarPose origin = changeReference(e.particle_mean, filter_.reference(), Eigen::Vector2d::Zero());
  e.T_ground_mav = air_ground_common::yawPose(origin.yaw, {origin.x, origin.y, at_mean.dz});
  e.cost = at_mean.cost;
  e.overlap = at_mean.overlap / static_cast<double>(cells.h.size());
  e.explained = at_mean.explained;
  e.relief = std::min(at_mean.relief_air, at_mean.relief_ground);
  e.reference_point = {e.particle_mean.x, e.particle_mean.y, cells.mean_height + at_mean.dz};
  const HeightMapLocalizerSettings& s = settings_;
  if (e.maps < s.min_maps || e.particle_spread > s.max_spread || e.particle_spread_yaw > s.max_spread_yaw) {
    e.reason = "the particles have not gathered yet";
    return;
  }
  e.status = Status::kConverged;
  e.reason = "the particles have gathered";
  const double sigma = std::hypot(e.particle_spread, s.floor_position);
  const double sigma_yaw = std::hypot(e.particle_spread_yaw, s.floor_yaw);
  e.covariance.setZero();
  e.covariance.diagonal() << sigma * sigma, sigma * sigma, s.floor_z * s.floor_z + 2 * at_mean.cost,
      2 * s.gravity_sigma * s.gravity_sigma, 2 * s.gravity_sigma * s.gravity_sigma, sigma_yaw * sigma_yaw;
}

}  // namespace heightmap_mcl
