// Analytic flight with exact IMU signals, and a cloud of points below it: ground truth for the tests of visual-inertial
// parts.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "visual_frontend/imu_preintegration.h"

namespace synthetic {

using air_ground_common::Pose;

struct Flight {
  double rest = 1.0;       ///< stand-still before take-off [s]
  double height = 1.8;     ///< [m]
  double radius = 1.2;     ///< of the loop [m]
  double period = 9.0;     ///< of the loop [s]
  double wobble = 0.06;    ///< amplitude of roll and pitch [rad]
  double yaw_rate = 0.15;  ///< [rad/s]

  /// 0 at rest, then time that starts with zero speed and acceleration.
  double flightTime(double t) const {
    const double tau = t - rest;
    if (tau <= 0) return 0;
    const double ramp = 2.0;
    const double s = std::min(1.0, tau / ramp);
    // Integral of the smoothstep of speed.
    return tau >= ramp ? tau - 0.5 * ramp : ramp * (s * s * s - 0.5 * s * s * s * s);
  }

  Pose T_world_imu(double t) const {
    const double f = flightTime(t), w = 2 * M_PI / period;
    Pose T = Pose::Identity();
    T.translation() = Eigen::Vector3d(
        radius * std::sin(w * f), radius * (1 - std::cos(w * f)) * 0.8 + 0.2 * std::sin(0.5 * w * f),
        0.4 + (height - 0.4) * (1 - std::exp(-f * f / 3.0)) + 0.15 * std::sin(1.3 * w * f) * (1 - std::exp(-f * f)));
    const double fade = 1 - std::exp(-f * f);
    T.linear() = (Eigen::AngleAxisd(yaw_rate * f, Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(wobble * fade * std::sin(2.1 * f), Eigen::Vector3d::UnitY()) *
                  Eigen::AngleAxisd(wobble * fade * std::sin(1.7 * f + 0.4), Eigen::Vector3d::UnitX()))
                     .toRotationMatrix();
    return T;
  }

  Eigen::Vector3d velocity(double t) const {
    const double h = 1e-4;
    return (T_world_imu(t + h).translation() - T_world_imu(t - h).translation()) / (2 * h);
  }

  /// Noise-free sample.
  visual_frontend::ImuSample imu(double t) const {
    const double h = 1e-3;
    const Pose T = T_world_imu(t);
    visual_frontend::ImuSample sample;
    sample.stamp = t;
    sample.angular_velocity =
        air_ground_common::logSO3(T_world_imu(t - h).linear().transpose() * T_world_imu(t + h).linear()) / (2 * h);
    const Eigen::Vector3d acceleration =
        (T_world_imu(t + h).translation() - 2 * T.translation() + T_world_imu(t - h).translation()) / (h * h);
    sample.specific_force = T.linear().transpose() * (acceleration + Eigen::Vector3d(0, 0, visual_frontend::kGravity));
    return sample;
  }

  /// Samples of [begin, end] at `rate` with white noise and constant biases.
  std::vector<visual_frontend::ImuSample> imuSamples(double begin, double end, double rate,
                                                     const visual_frontend::ImuNoise& noise,
                                                     const visual_frontend::ImuBias& bias, std::mt19937& random) const {
    std::normal_distribution<double> normal;
    const auto vector = [&] { return Eigen::Vector3d(normal(random), normal(random), normal(random)); };
    std::vector<visual_frontend::ImuSample> samples;
    for (int i = 0; begin + i / rate <= end + 1e-9; ++i) {
      visual_frontend::ImuSample s = imu(begin + i / rate);
      s.angular_velocity += bias.gyro + noise.gyro_density * std::sqrt(rate) * vector();
      s.specific_force += bias.accel + noise.accel_density * std::sqrt(rate) * vector();
      samples.push_back(s);
    }
    return samples;
  }
};

/// Camera that looks straight down: optical x = -y, y = -x, z = -z of the body.
inline Pose T_imu_camera() {
  Pose T = Pose::Identity();
  T.linear() << 0, -1, 0, -1, 0, 0, 0, 0, -1;
  T.translation() = Eigen::Vector3d(0.05, 0.01, -0.03);
  return T;
}

inline air_ground_common::CameraModel camera() {
  air_ground_common::CameraModel model;
  model.width = 752;
  model.height = 480;
  model.fx = model.fy = 420;
  model.cx = 375.5;
  model.cy = 239.5;
  return model;
}

/// Points on a floor with boxes, in the world [m].
inline std::vector<Eigen::Vector3d> pointCloud(int count, std::mt19937& random) {
  std::uniform_real_distribution<double> xy(-4, 5), z(0.0, 0.8), coin(0, 1);
  std::vector<Eigen::Vector3d> points(count);
  for (auto& p : points) p = Eigen::Vector3d(xy(random), xy(random), coin(random) < 0.5 ? 0.0 : z(random));
  return points;
}

}  // namespace synthetic
