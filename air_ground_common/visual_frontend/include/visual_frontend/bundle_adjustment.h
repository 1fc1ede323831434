// Bundle adjustment with Ceres of cameras and points, with optional depth residuals, gravity priors, and preintegrated
// inertial motion between the cameras, which makes scale and gravity direction observable (Forster 2017).
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "visual_frontend/imu_preintegration.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/self_calibration.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct BundleSettings {
  double pixel_sigma = 1.0;  ///< of a feature's position [px]
  RobustLoss loss = RobustLoss::kHuber;
  double loss_width = 2.0;        ///< in sigmas
  bool use_depth = true;          ///< depth residuals where observations carry depth
  double depth_loss_width = 2.0;  ///< Cauchy, in sigmas
  bool use_gravity = true;        ///< roll and pitch priors of keyframes that carry up_camera
  double gyro_bias_prior = 0.01;  ///< of the first state of a chain of inertial links against its start [rad/s]
  std::optional<Eigen::Vector3d> gyro_bias_mean = {};  ///< instead of that start [rad/s]
  double accel_bias_prior = 0.1;  ///< of the first state of a chain of inertial links against its start [m/s^2]
  int max_iterations = 10;
  double parameter_tolerance = 1e-7;  ///< relative step at which iterations end
  double max_seconds = 1.0;           ///< wall clock [s]; a result stopped by it is usable but not reproducible
  int threads = 1;
  double outlier_threshold = 3.0;  ///< sigmas; larger residuals are reported (and disconnected by applyBundle)
  /// Set to true from another thread, the iterations end, and the result is not usable. Null: they run to their end.
  std::shared_ptr<const std::atomic<bool>> cancelled = {};
};

struct InertialState {
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< of the IMU in the map [m/s]
  ImuBias bias;
};

/// Plain data: what the solver sees. Poses, points, states and calibration are changed in place.
struct BundleProblem {
  struct Camera {
    Pose T_map_camera = Pose::Identity();
    bool fixed = false;
    std::optional<Eigen::Vector3d> up_camera;  ///< unit
    double up_sigma = 0.02;                    ///< [rad]
    InertialState state;                       ///< used where a link touches the camera
    bool state_fixed = false;
  };
  struct Measurement {
    int camera = 0;
    int point = 0;
    Eigen::Vector2d normalized = Eigen::Vector2d::Zero();
    double sigma = 1.0 / 500;
    double depth = 0;  ///< measured z [m]; 0 = none
    double depth_sigma = 0;
    double elongation = 1;  ///< of the noise (NormalizedNoise)
    RayByCalibration by_calibration = RayByCalibration::Zero();
  };
  /// Relative pose that something else than the points tells, for example a gyro or depth.
  struct RelativePrior {
    int camera_a = 0, camera_b = 0;
    Pose T_a_b = Pose::Identity();
    /// W, with the information W^T W of (translation, rotation) of a perturbation d in T_a_b * exp(d); singular where
    /// nothing is told.
    Matrix6d sqrt_information = Matrix6d::Zero();
    bool may_be_false = false;  ///< then it may not bend the map
  };
  /// Inertial motion from one camera to a later one.
  struct InertialLink {
    int camera_a = 0, camera_b = 0;
    Preintegration motion;
  };
  /// How the IMU is turned against its mounting as given: its axes in the camera's are those of T_camera_imu exp(turn).
  struct Mounting {
    Eigen::Vector3d turn = Eigen::Vector3d::Zero();  ///< estimated [rad]
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();  ///< of it, before the links [rad]
    double sigma = 0.01;                             ///< standard deviation of that, per axis [rad]
  };
  std::vector<Camera> cameras;
  std::vector<Eigen::Vector3d> points;
  std::vector<unsigned char> point_fixed;  ///< empty = none
  std::vector<Measurement> measurements;
  std::vector<RelativePrior> priors;
  std::vector<InertialLink> links;
  Pose T_camera_imu = Pose::Identity();
  std::optional<Mounting> mounting;  ///< set, and in a metric map: estimated, too
  bool metric = true;                ///< false: the map's unit is not known, links bind rotations and gyro biases only
  /// Without a fixed camera: this one keeps its position and heading (roll, pitch and scale stay free, which links and
  /// gravity priors determine). -1: none.
  int anchor = -1;
  /// Set: estimated, too, with its covariance; the measurements are then changed to what the camera without the error
  /// sees.
  std::optional<CalibrationEstimate> calibration;
};

/// Square root of the information of a rotation known to `sigma` [rad] about each axis, and of nothing else.
Matrix6d sqrtRotationInformation(double sigma);

struct BundleResult {
  bool usable = false;
  std::string message;  ///< the solver's own words
  double initial_cost = 0, final_cost = 0;
  int iterations = 0;
  double seconds = 0;
  double rms = 0;             ///< reprojection error of the inliers per coordinate, in sigmas
  std::vector<int> outliers;  ///< indices of measurements beyond outlier_threshold, ascending
};

/// Throws std::invalid_argument for indices out of range or values that are not finite.
BundleResult solveBundle(BundleProblem& problem, const BundleSettings& settings);

}  // namespace visual_frontend
