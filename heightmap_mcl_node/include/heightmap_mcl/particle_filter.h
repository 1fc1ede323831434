// Monte Carlo localization on height maps (Forster 2013, VI-B, eq. 4 to 6).
#pragma once

#include <Eigen/Core>
#include <random>
#include <vector>

#include "heightmap_mcl/global_search.h"

namespace heightmap_mcl {

struct FilterSettings {
  int particles = 200;                     ///< M of eq. 4
  double sampling_sigma = 0.002;           ///< sigma of eq. 5 for the first distribution [m^2]
  double weight_sigma = 0.002;             ///< the same for the weights of later maps [m^2]
  double position_noise = 0.02;            ///< of eq. 6, along each axis for every map [m]
  double position_noise_per_metre = 0.03;  ///< added for each metre flown [m/m]
  double yaw_noise = 0.01;                 ///< for every map [rad]
  double yaw_noise_per_metre = 0.01;       ///< [rad/m]
  double mixture_ratio = 0.0;  ///< share of particles drawn anew from the cost volume at each resampling, in [0, 1)
};

/// Checks ranges; throws std::invalid_argument naming the field.
void validate(const FilterSettings& settings);

/// Where the MAV is in the ground map: position of the reference point, heading of the frame mav_map.
struct Particle {
  PlanarPose pose;
  double weight = 0;  ///< the weights sum to 1
};

/// A cluster of particles.
struct ParticleMode {
  PlanarPose mean;  ///< of the reference point
  double weight = 0;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of (x, y, yaw) [m^2, m rad, rad^2]
};

class ParticleFilter {
 public:
  /// The same seed gives the same sequence.
  ParticleFilter(const FilterSettings& settings, std::uint64_t seed);

  bool initialized() const { return !particles_.empty(); }
  void clear() { particles_.clear(); }
  /// Both sigmas are that share of the settings' from now on.
  void setSigmaShare(double share) { sigma_share_ = share; }
  const std::vector<Particle>& particles() const { return particles_; }
  const Eigen::Vector2d& reference() const { return reference_; }

  /// Samples all particles from p(u) ~ exp(-C(u)/sigma) (eq. 5) times the prior, stated for `reference`. False, and no
  /// particles, when the volume has no placement with enough overlap.
  bool initialize(const CostVolume& volume, const Prior& prior, const Eigen::Vector2d& reference);

  /// Motion model (eq. 6): the MAV moved from reference() to `reference` in its own map; every particle turns that
  /// displacement by its heading and adds noise.
  void move(const Eigen::Vector2d& reference);

  /// Multiplies the weights by exp(-C/sigma) at the particles. `cells` must have this filter's reference point. False,
  /// and unchanged weights, when no particle has enough overlap.
  bool weigh(const DirectCost& cost, const AerialCells& cells, const CostSettings& settings);

  /// Low-variance resampling; the mixture's share is drawn from `volume` when one is given.
  void resample(const CostVolume* volume, const Prior& prior);

  /// Clusters by density: particles within `distance` [m] and `angle` [rad] of a peak. Heaviest first.
  std::vector<ParticleMode> modes(double distance, double angle) const;

  /// Weighted mean of all; of the headings on the circle.
  PlanarPose mean() const;

  /// Square root of the mean of the position variances along x and y [m], and circular standard deviation of the
  /// heading.
  struct Spread {
    double position = 0, yaw = 0;
  };
  Spread spread() const;

 private:
  double samplingSigma() const { return sigma_share_ * settings_.sampling_sigma; }
  std::vector<PlanarPose> draw(const CostVolume& volume, const Prior& prior, int count);

  FilterSettings settings_;
  double sigma_share_ = 1;
  std::mt19937_64 random_;
  std::vector<Particle> particles_;
  Eigen::Vector2d reference_ = Eigen::Vector2d::Zero();
};

}  // namespace heightmap_mcl
