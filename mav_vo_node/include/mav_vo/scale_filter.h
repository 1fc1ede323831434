// Metric scale of monocular odometry from the accelerometer: Kalman filter over position, velocity, accelerometer bias,
// tilt of the map and the logarithm of the scale (after Nuetzi, Weiss, Scaramuzza, Siegwart 2011), started by a linear
// solution. Position and velocity are in the map's own unit: what is seen of them does not depend on the scale then,
// and a camera that flies steadily, however fast, tells nothing of it.
#pragma once

#include <Eigen/Core>
#include <deque>
#include <limits>
#include <optional>

#include "air_ground_common/geometry.h"
#include "mav_vo/imu_preintegration.h"

namespace mav_vo {

struct ScaleFilterSettings {
  double position_stddev = 0.003;      ///< white noise of the visual position, as a share of the scene's distance [1]
  double position_drift = 0.004;       ///< random walk of the visual position against the truth [m/sqrt(s)]
  double scale_drift = 0.001;          ///< random walk of the logarithm of the scale [1/sqrt(s)]
  double accel_bias_stddev = 0.3;      ///< before the first measurement, per axis [m/s^2]
  double velocity_stddev = 30.0;       ///< before the first measurement, per axis: of any aircraft [m/s]
  double rotation_walk = 2e-4;         ///< random walk of the tilt error of the visual attitude [rad/sqrt(s)]
  double min_start_duration = 1.0;     ///< shortest window of the start [s]
  double max_start_duration = 6.0;     ///< older frames leave the window of the start [s]
  double start_relative_stddev = 0.1;  ///< the start succeeds below this relative standard deviation of the scale [1]
  double start_max_nis =
      4.0;  ///< mean squared Mahalanobis distance of the start's innovations by degrees of freedom; 1 expected
  double gate = 16.27;  ///< squared Mahalanobis distance, chi-squared with 3 degrees of freedom at 99.9 %
};

/// One frame of visual odometry with the inertial motion since the frame before it.
struct ScaleMeasurement {
  Eigen::Vector3d p_map_camera =
      Eigen::Vector3d::Zero();  ///< camera's position in the gravity-aligned map [visual unit]
  Eigen::Matrix3d R_map_imu = Eigen::Matrix3d::Identity();  ///< its attitude, from vision
  Eigen::Vector3d p_imu_camera = Eigen::Vector3d::Zero();   ///< camera's position in the IMU frame: the lever arm [m]
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();     ///< of p_map_camera, from the landmarks' image noise
  double scene_distance = 1.0;                              ///< median distance of the points seen [visual unit]
  double stamp = 0;                                         ///< [s]
};

/// The state's error is (position 3, velocity 3, accelerometer bias 3, horizontal gravity 2, logarithm of the scale 1).
/// With k = exp(-L) the visual unit's share of a metre, a the preintegrated motion (Preintegration), g = (g_x, g_y,
/// -sqrt(9.81^2 - g_x^2 - g_y^2)):
///   p' = p + v dt + k (g dt^2 / 2 + R a_p(b)),  v' = v + k (g dt + R a_v(b));   measurement: p_visual = p + k R l, l
///   the lever arm.
/// The start solves a window: first linearly (k, k b and k g_xy themselves as states), then by Gauss-Newton steps about
/// that trajectory, which take the length of gravity for known. A window whose innovations are too large for their
/// covariance gives no start.
class ScaleFilter {
 public:
  static constexpr int kStates = 12;
  using Covariance = Eigen::Matrix<double, kStates, kStates>;
  struct State {
    Eigen::Vector3d p = Eigen::Vector3d::Zero();            ///< of the IMU [visual unit]
    Eigen::Vector3d v = Eigen::Vector3d::Zero();            ///< [visual unit/s]
    Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();   ///< [m/s^2]
    Eigen::Vector2d gravity_xy = Eigen::Vector2d::Zero();   ///< error of the map's tilt [m/s^2]
    double scale = 1.0;                                     ///< metric over visual unit
    Eigen::Vector3d gravity() const;                        ///< in the map; its length is kGravity [m/s^2]
    Eigen::Vector3d velocity() const { return scale * v; }  ///< [m/s]
  };

  /// `tilt_stddev`: of the map's z axis against gravity [rad].
  ScaleFilter(const ScaleFilterSettings& settings, const ImuNoise& noise, double tilt_stddev);

  /// Forgets everything; the next measurement starts afresh.
  void reset(double tilt_stddev);

  /// Starts in a metric map, without a window: at this frame the velocity [m/s] and the accelerometer bias [m/s^2] are
  /// known from bundle adjustment and the scale is 1 within `scale_stddev`.
  void startAt(const ScaleMeasurement& measurement, const Eigen::Vector3d& velocity, const Eigen::Vector3d& accel_bias,
               double scale_stddev);

  /// Next frame. `motion`: from the frame before to this one; empty for the first frame or after a gap in the IMU's
  /// data, which lets the velocity go. Values that are not finite are ignored.
  void add(const ScaleMeasurement& measurement, const std::optional<Preintegration>& motion);

  /// Tells that the map moved: p' = S p for the visual positions.
  void transform(const air_ground_common::Similarity& S_new_old);

  bool initialized() const { return initialized_; }
  double scale() const { return state_.scale; }  ///< metric over visual unit; 1 before initialisation
  double scaleStddev() const;                    ///< absolute; infinite before initialisation
  double relativeStddev() const;                 ///< of the scale; infinite before initialisation
  const State& state() const { return state_; }
  const Covariance& covariance() const { return P_; }  ///< of the error in the order above, scale as logarithm
  int rejected() const { return rejected_; }           ///< measurements outside the gate so far
  /// The scale is known within `relative_stddev`, and few measurements since the start spoke against it.
  bool certain(double relative_stddev) const;
  /// Relative standard deviation that the last attempt to start left; infinite before any.
  double startStddev() const { return start_stddev_; }
  /// Windows that a gap in the IMU's data has ended since the last reset, before one gave a start.
  int brokenWindows() const { return broken_windows_; }
  int updates() const { return updates_; }  ///< measurements since the start
  double rejectedShare() const;             ///< of them, outside the gate
  /// Mean squared normalised innovation by degrees of freedom since the start, the far ones counted as the gate; about
  /// 1 where IMU and images agree.
  double meanNis() const { return updates_ > 0 ? nis_sum_ / (3.0 * updates_) : 0.0; }
  /// The last window that gave a sure scale was refused: IMU and images do not tell of the same motion.
  bool contradicted() const { return contradicted_; }
  /// The last window gave a sure scale below zero: the accelerations have the sign of gravity.
  bool inverted() const { return inverted_; }

 private:
  struct Frame {
    ScaleMeasurement measurement;
    std::optional<Preintegration> motion;
  };
  /// Of the error at a first image that sees the IMU at the measured place less k R l; `inverse_scale`: k.
  Covariance priorCovariance(const ScaleMeasurement& first, double inverse_scale, double scale_stddev) const;
  void seeFirst(const ScaleMeasurement& first, double inverse_scale, Covariance* P) const;
  Covariance processNoise(const Preintegration& motion, const Eigen::Matrix3d& R, double inverse_scale) const;
  Eigen::Matrix3d visualNoise(const ScaleMeasurement& measurement) const;  ///< of p_map_camera
  void propagate(const Preintegration& motion, const Eigen::Matrix3d& R_map_imu_before, State* state, Covariance* F,
                 Covariance* Q) const;
  std::optional<State> linearSolution();
  bool start();
  void update(const ScaleMeasurement& measurement);
  void restartMotion(const ScaleMeasurement& measurement);

  ScaleFilterSettings settings_;
  ImuNoise noise_;
  double tilt_stddev_;
  std::deque<Frame> window_;
  int broken_windows_ = 0;
  bool initialized_ = false;
  State state_;
  Covariance P_ = Covariance::Zero();
  Eigen::Matrix3d R_before_ = Eigen::Matrix3d::Identity();
  double stamp_before_ = 0;  ///< [s]
  int rejected_ = 0;
  int rejected_in_a_row_ = 0;
  int updates_ = 0, rejected_updates_ = 0;  ///< since the start
  double nis_sum_ = 0;                      ///< since the start
  bool contradicted_ = false, inverted_ = false;
  double start_stddev_ = std::numeric_limits<double>::infinity();
  int frames_waited_ = 0;
};

}  // namespace mav_vo
