// Search over all offsets and headings, coarse to fine.
#pragma once

#include <optional>
#include <vector>

#include "heightmap_mcl/agreement.h"
#include "heightmap_mcl/fft_cost.h"

namespace heightmap_mcl {

/// What is known about the placement before any height map is compared; a flat density where a part is missing.
struct Prior {
  std::optional<double> yaw;                ///< heading of the aerial frame in the ground frame [rad]
  double yaw_sigma = 0.1;                   ///< [rad]
  std::optional<Eigen::Vector2d> position;  ///< of position_reference in the ground frame [m]
  Eigen::Vector2d position_reference = Eigen::Vector2d::Zero();  ///< in the aerial frame [m]
  double position_sigma = 0.5;                                   ///< along each axis [m]
  double position_radius = 0;  ///< a disc of even density instead, of this radius [m]; 0: none

  bool any() const { return yaw || position; }
  /// Logarithm of the density up to a constant, for a pose of `reference`.
  double logDensity(const PlanarPose& pose, const Eigen::Vector2d& reference) const;
  /// Within three standard deviations: what lies beyond is no place, and no rival.
  bool allows(const PlanarPose& pose, const Eigen::Vector2d& reference) const {
    return logDensity(pose, reference) >= -4.5;
  }
};

/// Headings to try [rad]: `count` over the full circle, or the same spacing (at most yaw_sigma) over +-3 sigma of a
/// known heading.
std::vector<double> searchHeadings(int count, const Prior& prior);

/// Costs over headings and offsets. Every pose refers to `pivot`, the centre of the aerial map (aerial frame).
struct CostVolume {
  Eigen::Vector2d pivot = Eigen::Vector2d::Zero();
  std::vector<CostMap> slices;  ///< one a heading
  bool circular = false;        ///< the headings go all round, evenly

  /// Lowest finite cost, infinite when there is none.
  double lowest() const;
};

/// Centre of the bounding box of the defined cells.
Eigen::Vector2d centerOf(const HeightMap& map);

/// `air`: resolution of the ground map behind `fft`.
CostVolume computeCostVolume(const FftCost& fft, const HeightMap& air, const std::vector<double>& headings,
                             bool circular, const CostSettings& settings);

/// Local minima of the volume that the prior allows, lowest first, at least `distance` [m] or `angle` [rad] apart.
std::vector<PlanarPose> findLocalMinima(const CostVolume& volume, std::size_t count, double distance, double angle,
                                        const Prior& prior = {});

/// Descends from `start` on the score of what agrees (agreement.h) at full resolution: the neighbours at steps that are
/// halved down to about half a cell, the first ones on a quarter of the cells, then a parabola along each axis. Of
/// large maps fewer cells lead there; the score is that of all. `step_xy` [m] and `step_yaw` [rad] are the first steps.
Placement descend(const DirectCost& cost, const AerialCells& cells, const PlanarPose& start, double step_xy,
                  double step_yaw, const CostSettings& settings);

/// What descents from the volume's `count` lowest minima reach (OpenMP); see findLocalMinima and descend.
std::vector<Placement> placesOfMinima(const CostVolume& volume, std::size_t count, double distance, double angle,
                                      const Prior& prior, const DirectCost& cost, const AerialCells& cells,
                                      double step_xy, double step_yaw, const CostSettings& settings);
/// The lowest score; without a finite one where there is none.
Placement bestOf(const std::vector<Placement>& places);

}  // namespace heightmap_mcl
