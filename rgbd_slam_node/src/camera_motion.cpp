#include "camera_motion.h"

#include <algorithm>
#include <cmath>

namespace rgbd_slam {

using air_ground_common::expSO3;
using air_ground_common::logSO3;

namespace {

// A rest tells the gyro's bias; a slow steady turn looks the same, up to the rate that a rest may have.
constexpr double kRestBiasSigma = 0.03;  // [rad/s]
constexpr double kBiasForRest = 0.003;   // [rad/s]; known so well, the bias tells rest from slow turns
constexpr double kLongPrediction = 0.5;  // from the last pose: then it no longer tells how the camera moves [s]
constexpr double kLeastHalf = 0.01;      // of the time over which samples are averaged [s]
constexpr double kDelaySigma = 1e-3;     // of a turn during depth's delay by the gyro: half a pixel [rad]

Pose imuOnCamera(const Mounting& mounting) {
  Pose T_base_imu = Pose::Identity();
  if (mounting.R_base_imu) T_base_imu.linear() = *mounting.R_base_imu;
  T_base_imu.translation() = mounting.p_base_imu;
  return mounting.T_base_camera.inverse() * T_base_imu;
}

}  // namespace

CameraMotion::CameraMotion(const CameraModel& camera, const Mounting& mounting, const SlamSettings& settings)
    : mounting_(mounting),
      given_readout_time_(settings.readout_time),
      time_offset_(settings.time_offset),
      initial_gyro_bias_(settings.inertial.initial_gyro_bias),
      inertial_(imuOnCamera(mounting), settings.inertial),
      rows_(camera, settings.readout_time),
      gyro_bias_sigma_(initial_gyro_bias_) {
  if (mounting.R_base_imu) R_camera_imu_ = mounting.T_base_camera.inverse().linear() * *mounting.R_base_imu;
}

bool CameraMotion::addImu(visual_frontend::ImuSample sample) {
  sample.stamp -= time_offset_;
  if (!hasImu() || !imu_.add(sample)) return false;
  attitude_.add(sample);
  if (!attitude_.atRest()) unrest_ = sample.stamp;
  return true;
}

Pose CameraMotion::predict(double last_stamp, const Pose& T_map_last, double stamp, bool* from_gyro) const {
  Pose T = T_map_last;
  const double dt = stamp - last_stamp;
  *from_gyro = false;
  if (gyroTrusted()) {
    if (const auto R = imu_.integrateRotation(last_stamp, stamp, gyro_bias_)) {
      T.linear() = T.linear() * (R_camera_imu_ * *R * R_camera_imu_.transpose());
      *from_gyro = true;
    }
  }
  if (!*from_gyro && dt < kLongPrediction) T.linear() = T.linear() * expSO3(turn_rate_ * dt);
  if (dt < kLongPrediction) T.translation() += velocity_ * dt;
  return T;
}

Pose CameraMotion::movedBy(double last_stamp, const Pose& T_map_last, double stamp, double delay) const {
  Eigen::Vector3d rate = Eigen::Vector3d::Zero(), v_map = Eigen::Vector3d::Zero();
  if (stamp - last_stamp < kLongPrediction) {
    rate = turn_rate_;
    v_map = velocityAt(stamp);
  }
  if (rotationSigma(std::abs(delay)) < kDelaySigma)
    if (const auto felt = feltRate(stamp + 0.5 * delay, std::max(0.5 * std::abs(delay), kLeastHalf))) rate = *felt;
  bool from_gyro = false;
  const Eigen::Matrix3d R_map_camera = predict(last_stamp, T_map_last, stamp, &from_gyro).linear();
  Pose T = Pose::Identity();
  T.linear() = expSO3(Eigen::Vector3d(rate * delay));
  T.translation() = R_map_camera.transpose() * v_map * delay;
  return T;
}

std::optional<Eigen::Vector3d> CameraMotion::feltRate(double stamp, double half) const {
  if (!gyroTrusted()) return std::nullopt;
  const auto mean = imu_.mean(stamp - half, stamp + half);
  if (mean.count == 0) return std::nullopt;
  return Eigen::Vector3d(R_camera_imu_ * (mean.angular_velocity - gyro_bias_));
}

std::optional<Eigen::Vector3d> CameraMotion::feltTurn(double from, double to) const {
  if (!hasImu()) return std::nullopt;
  const auto R = imu_.integrateRotation(from, to, Eigen::Vector3d::Zero());
  if (!R) return std::nullopt;
  return Eigen::Vector3d(*mounting_.R_base_imu * logSO3(Eigen::Matrix3d(*R)));
}

void CameraMotion::trustGyro(bool trusted) {
  if (trusted == gyro_trusted_) return;
  gyro_trusted_ = trusted;
  inertial_.newMap();
  inertial_.setGyroBias(Eigen::Vector3d::Zero(), initial_gyro_bias_);
  gyro_bias_.setZero();
  gyro_bias_sigma_ = initial_gyro_bias_;
}

void CameraMotion::setRowMotion(double stamp, const Pose& T_map_camera) {
  if (!rows_.active()) return;
  Eigen::Vector3d rate = turn_rate_;
  if (const auto felt = feltRate(stamp, std::max(0.5 * std::abs(rows_.readoutTime()), kLeastHalf))) rate = *felt;
  rows_.setMotion(rate, T_map_camera.linear().transpose() * velocityAt(stamp));
}

Eigen::Vector3d CameraMotion::velocityAt(double stamp) const {
  if (!gyroTrusted()) return velocity_;
  return inertial_.cameraVelocity(stamp, imu_).value_or(velocity_);
}

void CameraMotion::update(double dt, const Pose& T_before, const Pose& T_now) {
  const bool too_short = intervals_.tooShort(dt);
  intervals_.add(dt);
  if (too_short) return;  // the camera is taken to go on as before
  velocity_ = (T_now.translation() - T_before.translation()) / dt;
  turn_rate_ = logSO3(T_before.linear().transpose() * T_now.linear()) / dt;
}

void CameraMotion::interrupt() {
  velocity_.setZero();
  turn_rate_.setZero();
  inertial_.interrupt();
}

void CameraMotion::turn(const Eigen::Matrix3d& R) {
  velocity_ = R * velocity_;
  inertial_.transform(Pose(R));
}

void CameraMotion::startMap() {
  if (gyro_bias_sigma_ <= kRestBiasSigma || !attitude_.biasKnown()) return;
  inertial_.setGyroBias(attitude_.gyroBias(), kRestBiasSigma);
  gyro_bias_ = attitude_.gyroBias();
  gyro_bias_sigma_ = kRestBiasSigma;
}

void CameraMotion::addPose(double stamp, const Pose& T_map_camera, const Matrix6d& covariance) {
  if (!gyroTrusted()) return;
  // Landmarks err together, as in the covariance of the keyframes; calibration and rows of the image add to it.
  Matrix6d with_floor = 9 * covariance;
  with_floor.diagonal().head<3>().array() += 0.001 * 0.001;
  with_floor.diagonal().tail<3>().array() += 0.0005 * 0.0005;
  if (!inertial_.addPose(stamp, T_map_camera, with_floor, imu_)) return;
  const auto estimate = inertial_.estimate();
  if (!estimate) return;
  gyro_bias_ = estimate->gyro_bias;
  gyro_bias_sigma_ = estimate->gyro_bias_sigma;
  if (gyro_bias_sigma_ < kBiasForRest || !attitude_.biasKnown())
    attitude_.setGyroBias(gyro_bias_, gyro_bias_sigma_ < kBiasForRest);
}

std::optional<visual_frontend::InertialEstimate> CameraMotion::estimate() const {
  return gyroTrusted() ? inertial_.estimate() : std::nullopt;
}

void CameraMotion::endMap() {
  inertial_.newMap();
  velocity_.setZero();
  turn_rate_.setZero();
}

void CameraMotion::reset() {
  endMap();
  imu_.clear();
  coverage_.reset();
  attitude_.reset();
  inertial_.reset();
  rows_.setReadoutTime(given_readout_time_);
  intervals_.clear();
  gyro_trusted_ = true;
  unrest_ = -std::numeric_limits<double>::infinity();
  gyro_bias_.setZero();
  gyro_bias_sigma_ = initial_gyro_bias_;
}

}  // namespace rgbd_slam
