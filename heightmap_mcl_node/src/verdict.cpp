// The verdict on the best place: what the heights fix there, and how surely.
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <vector>

#include "air_ground_common/text.h"
#include "air_ground_common/units.h"
#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::formatted;
using air_ground_common::kDegree;
using air_ground_common::Vector6d;
using air_ground_common::wrapAngle;

Placement moved(const DirectCost& cost, const AerialCells& cells, const Placement& from, const Eigen::Vector3d& d,
                const CostSettings& settings) {
  const PlanarPose pose{from.pose.x + d.x(), from.pose.y + d.y(), from.pose.yaw + d.z()};
  return {pose, cost.agreement(cells, pose, from.agreement.offset, settings)};
}

/// Curvature of the cost (agreement.h) in (x, y, yaw) at a placement by central differences [m^2 per m^2, m rad,
/// rad^2]. What unknown cells are charged has no part in it: where the maps end fixes nothing.
Eigen::Matrix3d curvature(const DirectCost& cost, const AerialCells& cells, const Placement& best,
                          const CostSettings& settings, const Eigen::Vector3d& step) {
  const auto at = [&](const Eigen::Vector3d& d) {
    const double value = moved(cost, cells, best, d, settings).agreement.cost;
    return std::isfinite(value) ? value : best.agreement.cost;
  };
  Eigen::Matrix3d H;
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    const Eigen::Vector3d di = step[i] * Eigen::Vector3d::Unit(i), dj = step[j] * Eigen::Vector3d::Unit(j);
    H(i, i) = (at(-di) - 2 * best.agreement.cost + at(di)) / (step[i] * step[i]);
    H(i, j) = H(j, i) = (at(-di - dj) - at(-di + dj) - at(di - dj) + at(di + dj)) / (4 * step[i] * step[j]);
  }
  return H;
}

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

}  // namespace

/// Sets probe_ratio. The heading is scaled so that it moves the overlap's rim as far as a shift; tried are shifts all
/// round, turns about the middle, and the direction of the least curvature.
Eigen::Vector3d HeightMapLocalizer::probe(const Placement& best, const AerialCells& cells, const CostSettings& cost) {
  const HeightMapLocalizerSettings& s = settings_;
  const double radius = std::max(direct_->overlapAt(cells, best.pose).radius, 0.1);
  const Eigen::Vector3d scale(1, 1, 1 / radius);
  const Eigen::Matrix3d H =
      scale.asDiagonal() * curvature(*direct_, cells, best, cost, 0.5 * s.probe_distance * scale) * scale.asDiagonal();
  std::vector<Eigen::Vector3d> directions{Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(H).eigenvectors().col(0),
                                          Eigen::Vector3d::UnitZ()};
  constexpr int kHalf = 8;
  for (int i = 0; i < kHalf; ++i) {
    directions.emplace_back(std::cos(i * M_PI / kHalf), std::sin(i * M_PI / kHalf), 0);
  }
  Eigen::Vector3d weakest = Eigen::Vector3d::Zero();
  estimate_.probe_ratio = kInfinity;
  for (const Eigen::Vector3d& direction : directions) {
    const Eigen::Vector3d d = scale.cwiseProduct(direction) * s.probe_distance;
    for (int sign : {-1, 1}) {
      const double ratio = (moved(*direct_, cells, best, sign * d, cost).agreement.cost + s.noise_cost) /
                           (best.agreement.cost + s.noise_cost);
      if (ratio >= estimate_.probe_ratio) continue;
      estimate_.probe_ratio = ratio;
      weakest = d;
    }
  }
  return weakest;
}

Eigen::Vector3d HeightMapLocalizer::judge(const Placement& best, const AerialCells& cells, const CostSettings& cost,
                                          bool particles_agree) {
  const HeightMapLocalizerSettings& s = settings_;
  CoarseEstimate& e = estimate_;
  const Zmssd zmssd = (*direct_)(cells, best.pose, cost);
  e.cost = zmssd.cost;
  e.relief = std::min(zmssd.relief_air, zmssd.relief_ground);
  e.explained = zmssd.explained;
  e.agreement = best.agreement.agreeing;
  e.raised = best.agreement.raised * ground_.resolution * ground_.resolution;

  const Eigen::Vector3d weakest = probe(best, cells, cost);
  gatherEvidence();
  // Particles follow eq. 2: where much more speaks for the place, they are not asked.
  const bool asked = e.evidence < 2 * s.min_evidence;
  if (e.relief < s.min_relief) {
    e.status = Status::kDegenerate;
    e.reason = formatted("the overlap is flat: heights vary by %.3f m, %.3f m are needed", e.relief, s.min_relief);
  } else if (e.raised < s.min_raised) {
    e.status = Status::kDegenerate;
    e.reason = formatted("the overlap is bare: something stands on %.2f m^2 of it, %.2f m^2 are needed", e.raised,
                         s.min_raised);
  } else if (e.probe_ratio < s.probe_ratio) {
    e.status = Status::kDegenerate;
    e.reason = formatted("a move of (%.2f m, %.2f m, %.1f deg) changes the cost by a factor of %.2f only", weakest.x(),
                         weakest.y(), weakest.z() / kDegree, e.probe_ratio);
  } else if (e.rival_ratio < s.ambiguity_ratio) {
    e.status = Status::kAmbiguous;
    e.reason = formatted("another place %.2f m away fits about as well: it costs %.2f times as much", e.rival_distance,
                         e.rival_ratio);
  } else if (e.agreement < s.min_agreement) {
    e.reason = formatted("of what stands on the floor %.0f %% agree, %.0f %% are needed", 100 * e.agreement,
                         100 * s.min_agreement);
  } else if (e.maps < s.min_maps) {
    e.reason = formatted("%d of %d aerial maps seen", e.maps, s.min_maps);
  } else if (e.evidence < s.min_evidence) {
    e.reason = formatted("evidence for the place: %.1f of %.1f", e.evidence, s.min_evidence);
  } else if (asked && !particles_agree) {
    e.reason = "the particles have not gathered at the best place yet";
  } else if (asked && e.mode_weight < s.min_mode_weight) {
    e.reason = formatted("%.0f %% of the particles are at the best place, %.0f %% are needed", 100 * e.mode_weight,
                         100 * s.min_mode_weight);
  } else if (asked && (e.mode_spread > s.max_spread || e.mode_spread_yaw > s.max_spread_yaw)) {
    e.reason = formatted("the particles spread over %.2f m, %.1f deg", e.mode_spread, e.mode_spread_yaw / kDegree);
  } else {
    e.status = Status::kConverged;
    e.reason = formatted("%d maps; the next best place is %.1f times as bad; overlap %.0f %%", e.maps, e.rival_ratio,
                         100 * e.overlap);
  }
  e.guess = isGuess();
  if (e.guess) e.reason += "; a guess for the refinement: no other place has as much evidence";
  return weakest;
}

void HeightMapLocalizer::setCovariance(const Placement& best, const Placement& rival, const AerialCells& cells,
                                       const CostSettings& cost, const ParticleMode& mode,
                                       const Eigen::Vector3d& flattest) {
  const HeightMapLocalizerSettings& s = settings_;
  CoarseEstimate& e = estimate_;
  // Height of the overlap's middle: the aerial maps' mean, lifted.
  e.reference_point = {best.pose.x, best.pose.y, cells.mean_height + best.agreement.dz};
  if (e.status == Status::kSearching) return;  // the covariance of not knowing, as it was set up

  // Residuals of variance C, one independent in cells_per_independent: -log p = n C(u) / (2 C_min), so that the
  // information is n / (2 C_min) times the curvature of the cost.
  const double independent = independentCells(best.agreement);
  const double residual_variance = best.agreement.cost + s.noise_cost;
  const Eigen::Matrix3d H =
      curvature(*direct_, cells, best, cost, {2 * ground_.resolution, 2 * ground_.resolution, 2 * kDegree});
  // A direction without curvature gets a limit as its deviation: the rival distance (or angle) where the verdict has
  // excluded more, else all that the ground map leaves open.
  const bool degenerate = e.status == Status::kDegenerate;
  const double extent = std::max(ground_.width, ground_.height) * ground_.resolution;
  const Eigen::Vector3d limit = degenerate ? Eigen::Vector3d(extent, extent, M_PI)
                                           : Eigen::Vector3d(s.rival_distance, s.rival_distance, s.rival_angle);
  Eigen::Matrix3d information = H * independent / (2 * residual_variance);
  // The curvature of a flat floor is that of its noise.
  if (e.relief < s.min_relief) information.setZero();
  Eigen::Matrix3d planar = boundedInverse(information, limit);
  if (degenerate) {
    // The flattest direction changes the cost too little to be told from noise, whatever its curvature just here.
    const double reach =
        std::min(extent / std::max(flattest.head<2>().norm(), 1e-9), M_PI / std::max(std::abs(flattest.z()), 1e-9));
    const Eigen::Vector3d open = reach * flattest;
    planar += open * open.transpose();
  }

  // The particles' own scatter, carried from the MAV to the centre of the overlap.
  const PlanarPose mav = changeReference(best.pose, cells.reference, filter_.reference());
  const Eigen::Matrix3d carry = carriedBy({best.pose.x - mav.x, best.pose.y - mav.y});
  const Eigen::Matrix3d particles = carry * mode.covariance * carry.transpose();

  e.covariance.setZero();
  const int index[3] = {0, 1, 5};
  const bool sharp = mode.weight > 0.9;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) e.covariance(index[i], index[j]) = planar(i, j) + (sharp ? 0.0 : particles(i, j));
  }
  e.covariance(0, 0) += s.floor_position * s.floor_position;
  e.covariance(1, 1) += s.floor_position * s.floor_position;
  e.covariance(2, 2) = s.floor_z * s.floor_z + residual_variance / independent;
  e.covariance(3, 3) = e.covariance(4, 4) = 2 * s.gravity_sigma * s.gravity_sigma;
  e.covariance(5, 5) += s.floor_yaw * s.floor_yaw;
  if (e.status == Status::kAmbiguous) {
    // The truth may as well be over there.
    Vector6d way = Vector6d::Zero();
    way << rival.pose.x - best.pose.x, rival.pose.y - best.pose.y, rival.agreement.dz - best.agreement.dz, 0, 0,
        wrapAngle(rival.pose.yaw - best.pose.yaw);
    e.covariance += way * way.transpose();
  }
}

}  // namespace heightmap_mcl
