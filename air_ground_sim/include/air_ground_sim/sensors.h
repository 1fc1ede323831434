// From light to pixels, from depth to disparity, from motion to inertial readings: the sensors' imperfections.
#pragma once

#include <cstdint>
#include <vector>

#include "air_ground_common/geometry.h"
#include "air_ground_sim/config.h"
#include "air_ground_sim/faults.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/renderer.h"
#include "air_ground_sim/trajectory.h"

namespace air_ground_sim {

/// Exposure time chosen as a camera does it: from the last frame's mean, with some inertia.
class ExposureControl {
 public:
  explicit ExposureControl(const ImagerConfig& config);
  double exposure() const { return exposure_; }  ///< of the next frame [s]
  /// Mean grey value (of 1) of the frame taken with exposure().
  void update(double mean_grey);

 private:
  ImagerConfig config_;
  double exposure_;
};

/// Vignetting, shot and read noise, response curve, 8 bits.
class Imager {
 public:
  Imager(const ImagerConfig& config, std::uint64_t seed);

  /// `light` has `channels` values a pixel; `frame` selects the noise. Returns the mean grey value of 1.
  double expose(const std::vector<float>& light, int channels, double exposure, int frame,
                std::vector<std::uint8_t>* image) const;

  /// Share of light that reaches a pixel, 1 in the centre.
  float vignette(int x, int y) const { return vignette_[static_cast<std::size_t>(y) * config_.camera.width + x]; }

 private:
  ImagerConfig config_;
  std::uint64_t seed_;
  std::vector<float> vignette_;
  std::vector<float> gaussian_;         // quantiles of the normal distribution
  std::vector<std::uint8_t> response_;  // of 4096 steps of signal
};

/// Standard deviation of a Kinect's depth [m] at distance z [m] and incidence angle [rad] (Nguyen et al. 2012, eq.
/// 3-5).
double kinectAxialSigma(double z, double angle);

/// Applies the depth camera's noise; result in millimetres, 0 = no measurement.
void measureDepth(const DepthImage& truth, const DepthConfig& config, std::uint64_t seed, int frame,
                  std::vector<std::uint16_t>* depth_mm);

struct ImuReading {
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  ///< [rad/s]
  Eigen::Vector3d specific_force = Eigen::Vector3d::Zero();    ///< [m/s^2]; +9.81 on z at rest
};

/// Inertial unit fixed to a body; call measure() with rising times, one period apart.
class Imu {
 public:
  Imu(const ImuConfig& config, const air_ground_common::Pose& T_base_imu, std::uint64_t seed,
      const FaultsConfig& faults = FaultsConfig());

  /// What a perfect unit reads.
  ImuReading truth(const BodyState& state) const;
  /// truth() with bias, vibration and white noise; advances the bias walk by one period.
  ImuReading measure(const BodyState& state);
  const Eigen::Vector3d& gyroBias() const { return gyro_bias_; }
  const Eigen::Vector3d& accelBias() const { return accel_bias_; }

 private:
  Eigen::Vector3d noise();
  ImuConfig config_;
  air_ground_common::Pose T_base_imu_;
  Rng rng_;
  Vibration vibration_;
  int count_ = 0;  // of readings
  Eigen::Vector3d gyro_bias_, accel_bias_;
};

/// Earth's field in `world` (x east, y north, z up) near Zurich [T].
Eigen::Vector3d earthMagneticField();

}  // namespace air_ground_sim
