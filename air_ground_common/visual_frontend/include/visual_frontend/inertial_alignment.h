// Gravity, velocity and the biases of an IMU from metric camera poses, while the robot moves: no rest is needed.
#pragma once

#include <optional>

#include "visual_frontend/imu_attitude.h"
#include "visual_frontend/imu_preintegration.h"
#include "visual_frontend/types.h"

namespace visual_frontend {

struct InertialAlignmentSettings {
  /// Coarser than the sensor's data sheet: vibration, time jitter and scale factors count as noise, and for the gyro
  /// the drift of the camera's rotation, some milliradians in a second.
  ImuNoise noise{3e-3, 2e-2, 1e-4, 1e-3};
  double gravity_norm_sigma = 0.03;  ///< of kGravity: latitude, height, scale factor of the accelerometer [m/s^2]
  double initial_gyro_bias = 0.1;    ///< standard deviation of each component before anything is known [rad/s]
  double initial_accel_bias = 0.2;   ///< the same [m/s^2]
  double initial_velocity = 1.5;     ///< the same [m/s]
  double initial_acceleration =
      3.0;                      ///< of the robot at the start, when the specific force is taken for gravity [m/s^2]
  double map_tilt_walk = 1e-3;  ///< by which the map bends against gravity [rad/sqrt(s)]
  double pose_spacing = 0.1;    ///< poses nearer than this in time share their errors; one of them is used [s]
  double max_interval = 1.0;    ///< without a pose for longer, position and velocity start again [s]
  double gate = 22.5;           ///< of the squared innovation (6 DoF, 99.9 %); beyond it the map has jumped

  /// Throws std::invalid_argument, naming the field.
  void validate() const;
};

/// What is known about the IMU and gravity. Covariances are scaled by what the innovations say about the noise.
struct InertialEstimate {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();         ///< against gravity, unit, map frame
  double up_sigma = 0;                                   ///< standard deviation of the worst direction of tilt [rad]
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();    ///< of the IMU in the map [m/s]
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();   ///< [rad/s]
  double gyro_bias_sigma = 0;                            ///< of the worst direction [rad/s]
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();  ///< [m/s^2]
  int poses = 0;                                         ///< used so far
};

/// Error-state Kalman filter over (rotation, velocity, position, gyro bias, accelerometer bias, gravity in the map):
/// preintegrated IMU motion between poses (Forster et al. 2017), poses of visual SLAM as measurements. Given the
/// rotation the problem is linear (Martinelli 2014), so it needs no initial guess and equals the least-squares solution
/// over all poses; the norm of gravity is imposed on what is read out. Gravity and accelerometer bias are told apart by
/// rotation only: without it `up_sigma` stays at what the bias may be.
class InertialAlignment {
 public:
  /// `T_camera_imu`: mounting of the IMU on the camera.
  InertialAlignment(const Pose& T_camera_imu, const InertialAlignmentSettings& settings = {});

  /// Before the first pose: what a rest has shown already. [rad/s]
  void setGyroBias(const Eigen::Vector3d& bias, double sigma);

  /// Pose of the camera in the map with its covariance (x y z rotX rotY rotZ, map axes), in order of time. It is used
  /// when the buffer reaches it, at the latest with the next pose; false: not yet.
  bool addPose(double stamp, const Pose& T_map_camera, const Matrix6d& covariance, const ImuBuffer& imu);

  /// The map was turned or moved: p' = S * p for all that the filter knows.
  void transform(const Pose& S_new_old);

  /// Tracking was lost: position and velocity start again with the next pose; biases and gravity stay.
  void interrupt() {
    kinematics_known_ = false;
    pending_.reset();
  }
  /// The map was given up: gravity starts again, too. The biases stay.
  void newMap();
  /// Forgets everything.
  void reset();

  /// Velocity of the camera in the map at a time shortly after the last pose, by the IMU since then [m/s]. Empty before
  /// the biases have settled, or where there are no samples.
  std::optional<Eigen::Vector3d> cameraVelocity(double stamp, const ImuBuffer& imu) const;

  /// Empty before the second pose.
  std::optional<InertialEstimate> estimate() const;

 private:
  enum Block { kRotation = 0, kVelocity = 3, kPosition = 6, kGyro = 9, kAccel = 12, kGravityAt = 15, kSize = 18 };
  using Vector = Eigen::Matrix<double, kSize, 1>;
  using Matrix = Eigen::Matrix<double, kSize, kSize>;
  struct PoseMeasurement {
    double stamp;
    Pose T_map_camera;
    Matrix6d covariance;
  };

  bool advance(const PoseMeasurement& pose, const ImuBuffer& imu);
  bool start(const PoseMeasurement& pose, const ImuBuffer& imu);
  void predict(const std::vector<ImuSample>& samples);
  bool correct(const PoseMeasurement& pose);
  /// Pose of the IMU with the covariance of (rotation in IMU axes, position in map axes).
  std::pair<Pose, Matrix6d> imuPose(const PoseMeasurement& pose) const;
  void restartBlock(Block block, const Eigen::Matrix3d& covariance);

  Pose T_camera_imu_;
  InertialAlignmentSettings settings_;

  std::optional<PoseMeasurement> pending_;
  double stamp_ = -1;              ///< of the state [s]
  bool kinematics_known_ = false;  ///< rotation, velocity and position are those of stamp_
  bool gravity_started_ = false;
  int poses_ = 0;
  int refused_ = 0;             ///< poses in a row that failed the gate
  double mean_innovation_ = 1;  ///< squared, over its degrees of freedom

  Pose T_map_imu_ = Pose::Identity();
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();
  ImuBias bias_;
  Eigen::Vector3d gravity_ = Eigen::Vector3d::Zero();  ///< in the map, pointing down [m/s^2]
  Matrix P_ = Matrix::Zero();
};

}  // namespace visual_frontend
