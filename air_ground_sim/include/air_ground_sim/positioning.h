// Satellite positioning between houses, barometer, magnetometer near iron: what a city does to them.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "air_ground_common/geometry.h"
#include "air_ground_sim/config.h"
#include "air_ground_sim/random.h"

namespace air_ground_sim {

/// Slow error (Gauss-Markov), echoes that jump at random times, and white noise. Call measure() with rising times, one
/// period (1 / rate) apart.
class GpsReceiver {
 public:
  GpsReceiver(const GpsConfig& config, std::uint64_t seed);
  /// Position in world as received [m]; advances the errors by one period.
  Eigen::Vector3d measure(const Eigen::Vector3d& position);

 private:
  Eigen::Vector3d noise();
  GpsConfig config_;
  Rng rng_;
  Eigen::Vector3d slow_, echo_;
};

/// Pressure of the standard atmosphere at a height above sea level [Pa] (ICAO, troposphere).
double standardPressure(double height);

class Barometer {
 public:
  Barometer(const BarometerConfig& config, std::uint64_t seed);
  /// Pressure [Pa] at a height above sea level [m]; advances the drift by one period.
  double measure(double height);

 private:
  BarometerConfig config_;
  Rng rng_;
  double offset_;  // [Pa]
};

class Magnetometer {
 public:
  /// Magnetometers in one world share the iron nearby: `iron_seed`.
  Magnetometer(const ImuConfig& config, std::uint64_t noise_seed, std::uint64_t iron_seed)
      : config_(config), noise_(noise_seed), iron_seed_(iron_seed) {}
  /// The field in the sensor's frame [T].
  Eigen::Vector3d measure(const air_ground_common::Pose& T_world_imu);

 private:
  ImuConfig config_;
  Rng noise_;
  std::uint64_t iron_seed_;
};

/// Field of iron nearby at a place in world [T]: each axis of root mean square `amplitude`, changing over about 4 m.
Eigen::Vector3d magneticDisturbance(const Eigen::Vector3d& position, double amplitude, std::uint64_t seed);

}  // namespace air_ground_sim
