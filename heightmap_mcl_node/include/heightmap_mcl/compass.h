// Heading of the MAV's map in the ground robot's from the magnetic field that both feel (Forster 2013, VI: "the
// magnetic north direction could be recovered from the IMU").
#pragma once

#include <Eigen/Core>
#include <optional>

#include "heightmap_mcl/global_search.h"

namespace heightmap_mcl {

/// Direction of magnetic north in a robot's map, from its readings turned into the map's axes.
class MagneticNorth {
 public:
  /// A reading in the map's axes (z up), in any unit. False, and ignored, when it is not finite or nearly vertical.
  bool add(const Eigen::Vector3d& field);
  void clear() { *this = MagneticNorth(); }

  /// Direction in the map, counted from its x axis [rad]; empty below 20 readings.
  std::optional<double> direction() const;
  /// Circular standard deviation of the readings [rad]: noise, and iron that the robot drives past.
  double deviation() const;

 private:
  double weight_ = 0, x_ = 0, y_ = 0;
};

/// The prior that two compasses give; empty while one does not know. `sigma`: of what both have in common, such as a
/// field that bends between the robots [rad].
std::optional<Prior> headingPrior(const MagneticNorth& ground, const MagneticNorth& mav, double sigma);

}  // namespace heightmap_mcl
