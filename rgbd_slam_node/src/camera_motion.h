// How the camera moves: by its last two poses, the gyro, and the IMU's biases that come with its motion.
#pragma once

#include <limits>
#include <optional>
#include <string>

#include "rgbd_slam/slam.h"
#include "visual_frontend/image_intervals.h"

namespace rgbd_slam {

class CameraMotion {
 public:
  CameraMotion(const CameraModel& camera, const Mounting& mounting, const SlamSettings& settings);

  bool hasImu() const { return mounting_.R_base_imu.has_value(); }
  bool gyroTrusted() const { return hasImu() && gyro_trusted_; }
  bool addImu(visual_frontend::ImuSample sample);

  /// Pose at `stamp` after the last one known; `from_gyro`: the gyro tells its rotation.
  Pose predict(double last_stamp, const Pose& T_map_last, double stamp, bool* from_gyro) const;
  /// Pose of the camera `delay` [s] after `stamp` in its frame at `stamp`, by the gyro, where its bias is known well
  /// enough for that, and by the last two poses, the last at `last_stamp`; what neither tells counts as no motion.
  Pose movedBy(double last_stamp, const Pose& T_map_last, double stamp, double delay) const;
  /// Standard deviation of the predicted rotation by the gyro's bias [rad].
  double rotationSigma(double dt) const { return gyro_bias_sigma_ * dt; }
  /// How the gyro felt the base turn between two stamps: rotation vector in the base [rad]. None without its samples.
  std::optional<Eigen::Vector3d> feltTurn(double from, double to) const;
  /// Sees whether there are samples for the time between two frames ...
  void checkCoverage(double from, double to) { coverage_.add(imu_, from, to); }
  const std::string& coverageProblem() const { return coverage_.problem(); }  ///< ... empty: there mostly are
  /// False: the gyro contradicts the images, and nothing is taken from it any more.
  void trustGyro(bool trusted);
  /// Motion during the frame at `stamp`, for the rows of the image; the camera is about at `T_map_camera`.
  void setRowMotion(double stamp, const Pose& T_map_camera);
  const visual_frontend::RollingShutter& rows() const { return rows_; }
  void setCamera(const CameraModel& camera) { rows_.setCamera(camera); }            ///< the same, better known
  void setReadoutTime(double readout_time) { rows_.setReadoutTime(readout_time); }  ///< [s]

  void update(double dt, const Pose& T_before, const Pose& T_now);
  /// Between two frames, by which a speed is told: stamps may jitter [s].
  double plausibleInterval(double dt) const { return intervals_.plausible(dt); }
  void interrupt();                                        ///< after a loss or a gap
  void turn(const Eigen::Matrix3d& R);                     ///< the map was turned
  void moveMap(const Pose& T) { inertial_.transform(T); }  ///< by a loop closure

  /// With a new map at hand: what a rest has shown of the gyro's bias.
  void startMap();
  /// Gravity and biases from the motion up to this frame.
  void addPose(double stamp, const Pose& T_map_camera, const Matrix6d& covariance);

  const visual_frontend::AttitudeFilter& attitude() const { return attitude_; }
  /// The IMU felt nothing from the one stamp to the other: the robot stood, or went on evenly [s].
  bool restedBetween(double from, double to) const { return gyroTrusted() && attitude_.knownAt(to) && unrest_ <= from; }
  double lastUnrest() const { return unrest_; }  ///< when the IMU last felt something [s]
  bool upKnownAt(double stamp) const { return hasImu() && attitude_.knownAt(stamp); }  ///< by the accelerometer
  Eigen::Vector3d upInBase() const { return *mounting_.R_base_imu * attitude_.up(); }  ///< likewise
  Eigen::Vector3d upInCamera() const { return R_camera_imu_ * attitude_.up(); }        ///< by the accelerometer
  std::optional<visual_frontend::InertialEstimate> estimate() const;
  const Eigen::Vector3d& gyroBias() const { return gyro_bias_; }

  void endMap();  ///< biases stay
  void reset();

 private:
  /// In the camera [rad/s], by the gyro's samples of `half` [s] before and after; none: not trusted, or no samples.
  std::optional<Eigen::Vector3d> feltRate(double stamp, double half) const;
  /// In the map [m/s]: by IMU and poses together, else by the last two poses.
  Eigen::Vector3d velocityAt(double stamp) const;

  Mounting mounting_;
  double given_readout_time_, time_offset_, initial_gyro_bias_;
  Eigen::Matrix3d R_camera_imu_ = Eigen::Matrix3d::Identity();
  visual_frontend::ImuBuffer imu_;
  visual_frontend::ImuCoverage coverage_;
  visual_frontend::AttitudeFilter attitude_;
  visual_frontend::InertialAlignment inertial_;
  visual_frontend::RollingShutter rows_;  ///< with the motion during the present frame
  Eigen::Vector3d gyro_bias_ = Eigen::Vector3d::Zero();
  double gyro_bias_sigma_;
  double unrest_ = -std::numeric_limits<double>::infinity();  ///< [s]
  bool gyro_trusted_ = true;
  visual_frontend::ImageIntervals intervals_;
  Eigen::Vector3d velocity_ = Eigen::Vector3d::Zero();   ///< of the camera in the map [m/s]
  Eigen::Vector3d turn_rate_ = Eigen::Vector3d::Zero();  ///< of the camera, camera frame [rad/s]
};

}  // namespace rgbd_slam
