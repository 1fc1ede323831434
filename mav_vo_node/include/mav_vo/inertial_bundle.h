// Bundle adjustment of keyframes, landmarks, velocities and IMU biases: reprojection errors tied by preintegrated
// inertial motion between keyframes, which makes scale and gravity direction observable (Forster 2017; cost functions
// on Ceres).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "mav_vo/imu_preintegration.h"
#include "visual_frontend/bundle_adjustment.h"

namespace mav_vo {

struct InertialBundleSettings {
  visual_frontend::RobustLoss loss = visual_frontend::RobustLoss::kHuber;
  double loss_width = 2.0;         ///< in sigmas of a feature
  double outlier_threshold = 3.0;  ///< sigmas; larger residuals are reported
  double gyro_bias_prior = 0.01;   ///< of the first state of a chain of links against its start [rad/s]
  std::optional<Eigen::Vector3d> gyro_bias_mean = {};  ///< instead of that start [rad/s]
  double accel_bias_prior = 0.1;  ///< of the first state of a chain of links against its start [m/s^2]
  int max_iterations = 10;
  double max_seconds = 10.0;  ///< wall clock [s]; a result stopped by it is usable but not reproducible
  int threads = 1;
};

struct InertialState {
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< of the IMU in the map [m/s]
  ImuBias bias;
};

/// Plain data: what the solver sees and changes.
struct InertialBundleProblem {
  bool metric = true;  ///< false: the map's unit is not known, links bind rotations and gyro biases only
  visual_frontend::BundleProblem visual;   ///< depth and relative priors are not used here
  std::vector<InertialState> states;       ///< one a camera; used where a link touches the camera
  std::vector<unsigned char> state_fixed;  ///< one a camera
  struct Link {
    int a = 0, b = 0;  ///< cameras, b after a
    Preintegration motion;
  };
  std::vector<Link> links;
  air_ground_common::Pose T_camera_imu = air_ground_common::Pose::Identity();
  /// Without a fixed camera: this one keeps its position and heading (roll, pitch and scale stay free, which links and
  /// gravity priors determine). -1: none.
  int anchor = -1;
};

using InertialBundleResult = visual_frontend::BundleResult;

/// Throws std::invalid_argument when sizes or indices do not fit.
InertialBundleResult solveInertialBundle(InertialBundleProblem& problem, const InertialBundleSettings& settings);

}  // namespace mav_vo
