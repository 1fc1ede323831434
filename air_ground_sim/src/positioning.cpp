#include "air_ground_sim/positioning.h"

#include <cmath>

#include "air_ground_sim/noise.h"
#include "air_ground_sim/sensors.h"

namespace air_ground_sim {

GpsReceiver::GpsReceiver(const GpsConfig& config, std::uint64_t seed) : config_(config), rng_(seed) {
  slow_ =
      noise().cwiseProduct(Eigen::Vector3d(config.horizontal_stddev, config.horizontal_stddev, config.vertical_stddev));
  echo_ = config.jump_stddev * noise().cwiseProduct(Eigen::Vector3d(1, 1, 3));
}

Eigen::Vector3d GpsReceiver::noise() {
  Eigen::Vector3d n;
  for (int i = 0; i < 3; ++i) n[i] = rng_.gaussian();
  return n;
}

Eigen::Vector3d GpsReceiver::measure(const Eigen::Vector3d& position) {
  const double period = 1 / config_.rate;
  const Eigen::Vector3d measured =
      position + slow_ + echo_ + config_.noise * noise().cwiseProduct(Eigen::Vector3d(1, 1, 2));
  const double keep = std::exp(-period / config_.correlation_time), fresh = std::sqrt(1 - keep * keep);
  slow_ = keep * slow_ + fresh * noise().cwiseProduct(Eigen::Vector3d(
                                     config_.horizontal_stddev, config_.horizontal_stddev, config_.vertical_stddev));
  if (rng_.chance(1 - std::exp(-period / config_.jump_interval)))
    echo_ = config_.jump_stddev * noise().cwiseProduct(Eigen::Vector3d(1, 1, 3));
  return measured;
}

double standardPressure(double height) { return 101325.0 * std::pow(1 - 0.0065 * height / 288.15, 5.25588); }

Barometer::Barometer(const BarometerConfig& config, std::uint64_t seed)
    : config_(config), rng_(seed), offset_(config.weather_stddev * rng_.gaussian()) {}

double Barometer::measure(double height) {
  const double pressure = standardPressure(height) + offset_ + config_.noise * rng_.gaussian();
  offset_ += config_.drift / std::sqrt(config_.rate) * rng_.gaussian();
  return pressure;
}

Eigen::Vector3d Magnetometer::measure(const air_ground_common::Pose& T_world_imu) {
  Eigen::Vector3d field = earthMagneticField();
  if (config_.mag_disturbance > 0)
    field += magneticDisturbance(T_world_imu.translation(), config_.mag_disturbance, iron_seed_);
  field = T_world_imu.linear().transpose() * field;
  for (int i = 0; i < 3; ++i) field[i] += config_.mag_noise * noise_.gaussian();
  return field;
}

Eigen::Vector3d magneticDisturbance(const Eigen::Vector3d& position, double amplitude, std::uint64_t seed) {
  Eigen::Vector3d field;
  const Eigen::Vector3f p = (position / 4.0).cast<float>();
  // Value noise has a root mean square of 0.37 in three dimensions (measured over 10^6 places).
  for (int k = 0; k < 3; ++k)
    field[k] = amplitude / 0.37 * valueNoise(p.x(), p.y(), p.z(), static_cast<std::uint32_t>(mix(seed, k)));
  return field;
}

}  // namespace air_ground_sim
