// What real robots' recordings suffer from beside noise: time offsets, rolling shutters, vibration, biases, JPEG.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace air_ground_sim {

/// How /tf_static is recorded: one latched message; a message a transform over one connection that does not latch; a
/// latched message a transform, each of a publisher of its own.
enum class StaticTransforms { kLatched, kSplit, kPublishers };

/// Everything is off by default.
struct FaultsConfig {
  double time_offset = 0;          ///< of inertial and magnetic readings: their stamp minus their true time [s]
  double readout_time = 0;         ///< rolling shutters: row r is seen at stamp + (r / height - 1/2) readout_time [s]
  double vibration = 0;            ///< root mean square of each axis of the accelerometers, 30 to 120 Hz [m/s^2]
  std::vector<double> gyro_bias;   ///< at time 0 [rad/s]: its norm, or three numbers; empty: as in ImuConfig
  std::vector<double> accel_bias;  ///< at time 0 [m/s^2], likewise
  bool start_in_motion = false;    ///< the recording begins when both robots move as they do later
  int jpeg_quality = 0;            ///< of the colour and grey images, 1 to 100; 0: raw images
  double radial_error = 0;         ///< of both published calibrations: their k1 minus the true one
  double focal_error = 0;          ///< likewise: their focal lengths, relative
  double lost_images = 0;          ///< share of each robot's images that is not recorded, 1 to 5 in a row
  double clock_offset = 0;         ///< of the ground robot's clock: its stamps minus the MAV's [s]
  double depth_delay = 0;          ///< its depth images are taken, and stamped, so long after the colour images [s]
  StaticTransforms tf_static = StaticTransforms::kLatched;

  bool any() const;
  /// Throws std::invalid_argument that names the field.
  void validate() const;
  /// As YAML, a line a field.
  std::string describe() const;

  /// A consumer drone and a phone's camera: all of a recording's faults that an estimator has to live with at once. The
  /// robots' clocks agree, colour and depth are taken at once, /tf_static is latched.
  static FaultsConfig all();
};

/// Which of `count` images are lost: each gap begins at random and lasts 1 to 5 images, in all about `share` of them.
std::vector<bool> lostImages(double share, int count, std::uint64_t seed);

/// `drawn` scaled as asked: by `stddev`, to the norm `asked[0]`, or replaced by three numbers.
Eigen::Vector3d initialBias(double stddev, const Eigen::Vector3d& drawn, const std::vector<double>& asked);

/// Rotors' and motors' vibration at the inertial unit: on each axis tones of random frequency and phase.
class Vibration {
 public:
  /// `rms` of each axis [m/s^2].
  Vibration(double rms, std::uint64_t seed);

  Eigen::Vector3d acceleration(double time) const;  ///< [m/s^2]
  /// Of a body that rocks so that a place 0.1 m from its centre is shaken by acceleration's root mean square [rad/s].
  Eigen::Vector3d angularVelocity(double time) const;

 private:
  static constexpr int kTones = 16;  // an axis
  struct Tone {
    double frequency, phase, rocking_phase;  // [rad/s], [rad]
  };
  double amplitude_;
  std::vector<Tone> tones_;  // axis after axis
};

}  // namespace air_ground_sim
