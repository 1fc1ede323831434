#include "visual_frontend/inertial_alignment.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "air_ground_common/covariance.h"
#include "air_ground_common/linear_algebra.h"

namespace visual_frontend {

using air_ground_common::expSO3;
using air_ground_common::logSO3;
using air_ground_common::skew;

namespace {

double square(double x) { return x * x; }

Eigen::Matrix3d isotropic(double sigma) { return Eigen::Matrix3d::Identity() * square(sigma); }

constexpr int kRefusedInARow = 3;         // poses beyond the gate that mean a jump of the map, not an outlier
constexpr double kInnovationMemory = 50;  // poses

}  // namespace

void InertialAlignmentSettings::validate() const {
  noise.validate();
  const auto require = [](bool ok, const char* field) {
    if (!ok) throw std::invalid_argument(std::string("InertialAlignmentSettings::") + field + " must be positive");
  };
  require(gravity_norm_sigma > 0, "gravity_norm_sigma");
  require(initial_gyro_bias > 0, "initial_gyro_bias");
  require(initial_accel_bias > 0, "initial_accel_bias");
  require(initial_velocity > 0, "initial_velocity");
  require(initial_acceleration > 0, "initial_acceleration");
  require(map_tilt_walk > 0, "map_tilt_walk");
  require(pose_spacing > 0, "pose_spacing");
  require(max_interval > pose_spacing, "max_interval less pose_spacing");
  require(gate > 0, "gate");
}

InertialAlignment::InertialAlignment(const Pose& T_camera_imu, const InertialAlignmentSettings& settings)
    : T_camera_imu_(T_camera_imu), settings_(settings) {
  settings_.validate();
  reset();
}

void InertialAlignment::reset() {
  newMap();
  poses_ = 0;
  mean_innovation_ = 1;
  bias_ = ImuBias();
  P_.setZero();
  restartBlock(kGyro, isotropic(settings_.initial_gyro_bias));
  restartBlock(kAccel, isotropic(settings_.initial_accel_bias));
}

void InertialAlignment::newMap() {
  interrupt();
  gravity_started_ = false;
  refused_ = 0;
}

void InertialAlignment::setGyroBias(const Eigen::Vector3d& bias, double sigma) {
  bias_.gyro = bias;
  restartBlock(kGyro, isotropic(sigma));
}

void InertialAlignment::restartBlock(Block block, const Eigen::Matrix3d& covariance) {
  P_.middleRows<3>(block).setZero();
  P_.middleCols<3>(block).setZero();
  P_.block<3, 3>(block, block) = covariance;
}

bool InertialAlignment::addPose(double stamp, const Pose& T_map_camera, const Matrix6d& covariance,
                                const ImuBuffer& imu) {
  if (pending_) {
    advance(*pending_, imu);
    pending_.reset();
  }
  if (kinematics_known_ && stamp - stamp_ < settings_.pose_spacing - 1e-3) return false;
  const PoseMeasurement pose{stamp, T_map_camera, covariance};
  if (!imu.empty() && imu.samples().back().stamp >= stamp) return advance(pose, imu);
  pending_ = pose;
  return false;
}

bool InertialAlignment::advance(const PoseMeasurement& pose, const ImuBuffer& imu) {
  if (!kinematics_known_ || pose.stamp - stamp_ > settings_.max_interval) return start(pose, imu);
  const std::vector<ImuSample> samples = samplesBetween(imu, stamp_, pose.stamp);
  if (samples.size() < 2) return start(pose, imu);
  predict(samples);
  stamp_ = pose.stamp;
  if (correct(pose)) {
    refused_ = 0;
    ++poses_;
    return true;
  }
  return ++refused_ >= kRefusedInARow && start(pose, imu);
}

std::pair<Pose, Matrix6d> InertialAlignment::imuPose(const PoseMeasurement& pose) const {
  const Pose T_map_imu = pose.T_map_camera * T_camera_imu_;
  const Eigen::Vector3d lever = T_map_imu.translation() - pose.T_map_camera.translation();
  Matrix6d J = Matrix6d::Zero();  // (rotation in IMU axes, position) by (position, rotation in map axes)
  J.topRightCorner<3, 3>() = T_map_imu.linear().transpose();
  J.bottomLeftCorner<3, 3>().setIdentity();
  J.bottomRightCorner<3, 3>() = -skew(lever);
  return {T_map_imu, J * pose.covariance * J.transpose()};
}

bool InertialAlignment::start(const PoseMeasurement& pose, const ImuBuffer& imu) {
  const auto [T_map_imu, covariance] = imuPose(pose);
  kinematics_known_ = false;
  const double gap = stamp_ > 0 ? std::max(0.0, pose.stamp - stamp_) : 0;
  if (!gravity_started_) {
    const ImuBuffer::Mean mean = imu.mean(pose.stamp - 0.1, pose.stamp + 0.05);
    if (mean.count == 0 || mean.specific_force.norm() < 0.1 * kGravity) return false;
    gravity_ = -kGravity * (T_map_imu.linear() * mean.specific_force).normalized();
    restartBlock(kGravityAt, isotropic(settings_.initial_acceleration));
    gravity_started_ = true;
  } else {
    P_.block<3, 3>(kGravityAt, kGravityAt) += isotropic(kGravity * settings_.map_tilt_walk * std::sqrt(gap));
    P_.block<3, 3>(kGyro, kGyro) += isotropic(settings_.noise.gyro_bias_walk * std::sqrt(gap));
    P_.block<3, 3>(kAccel, kAccel) += isotropic(settings_.noise.accel_bias_walk * std::sqrt(gap));
  }
  T_map_imu_ = T_map_imu;
  velocity_.setZero();
  restartBlock(kRotation, covariance.topLeftCorner<3, 3>());
  restartBlock(kVelocity, isotropic(settings_.initial_velocity));
  restartBlock(kPosition, covariance.bottomRightCorner<3, 3>());
  kinematics_known_ = true;
  stamp_ = pose.stamp;
  refused_ = 0;
  ++poses_;
  return true;
}

void InertialAlignment::predict(const std::vector<ImuSample>& samples) {
  Preintegration motion(settings_.noise, bias_);
  motion.integrate(samples);
  const double dt = motion.duration();
  const Eigen::Matrix3d R = T_map_imu_.linear();
  const Eigen::Matrix<double, 9, 6>& J = motion.biasJacobian();
  Matrix F = Matrix::Identity();
  F.block<3, 3>(kRotation, kRotation) = motion.rotation().transpose();
  F.block<3, 3>(kVelocity, kRotation) = -R * skew(motion.velocity());
  F.block<3, 3>(kPosition, kRotation) = -R * skew(motion.position());
  F.block<3, 3>(kPosition, kVelocity) = Eigen::Matrix3d::Identity() * dt;
  F.block<3, 6>(kRotation, kGyro) = J.topRows<3>();
  F.block<3, 6>(kVelocity, kGyro) = R * J.middleRows<3>(3);
  F.block<3, 6>(kPosition, kGyro) = R * J.bottomRows<3>();
  F.block<3, 3>(kVelocity, kGravityAt) = Eigen::Matrix3d::Identity() * dt;
  F.block<3, 3>(kPosition, kGravityAt) = Eigen::Matrix3d::Identity() * (0.5 * dt * dt);

  Eigen::Matrix<double, 9, 9> G = Eigen::Matrix<double, 9, 9>::Identity();
  G.block<3, 3>(3, 3) = G.block<3, 3>(6, 6) = R;
  P_ = F * P_ * F.transpose();
  P_.topLeftCorner<9, 9>() += G * motion.covariance() * G.transpose();
  P_.block<3, 3>(kGyro, kGyro) += isotropic(settings_.noise.gyro_bias_walk * std::sqrt(dt));
  P_.block<3, 3>(kAccel, kAccel) += isotropic(settings_.noise.accel_bias_walk * std::sqrt(dt));
  P_.block<3, 3>(kGravityAt, kGravityAt) += isotropic(kGravity * settings_.map_tilt_walk * std::sqrt(dt));

  T_map_imu_.translation() += velocity_ * dt + 0.5 * dt * dt * gravity_ + R * motion.position();
  velocity_ += gravity_ * dt + R * motion.velocity();
  T_map_imu_.linear() = R * motion.rotation();
}

bool InertialAlignment::correct(const PoseMeasurement& pose) {
  const auto [T_measured, covariance] = imuPose(pose);
  Vector6d residual;
  residual << logSO3(T_map_imu_.linear().transpose() * T_measured.linear()),
      T_measured.translation() - T_map_imu_.translation();
  Eigen::Matrix<double, kSize, 6> PHt;
  PHt << P_.middleCols<3>(kRotation), P_.middleCols<3>(kPosition);
  Matrix6d S = covariance;
  S.topRows<3>() += PHt.middleRows<3>(kRotation);
  S.bottomRows<3>() += PHt.middleRows<3>(kPosition);
  const Matrix6d S_inverse = air_ground_common::inverse(S);
  const double squared = residual.dot(S_inverse * residual);
  if (!std::isfinite(squared)) return false;
  const bool passed = squared < settings_.gate * std::max(1.0, mean_innovation_);
  mean_innovation_ += (std::min(squared / 6, 10.0) - mean_innovation_) / std::min(10.0 + poses_, kInnovationMemory);
  if (!passed) return false;

  const Eigen::Matrix<double, kSize, 6> K = PHt * S_inverse;
  const Vector dx = K * residual;
  Matrix I_KH = Matrix::Identity();
  I_KH.middleCols<3>(kRotation) -= K.leftCols<3>();
  I_KH.middleCols<3>(kPosition) -= K.rightCols<3>();
  P_ = I_KH * P_ * I_KH.transpose() + K * covariance * K.transpose();
  T_map_imu_.linear() =
      Eigen::Quaterniond(T_map_imu_.linear() * expSO3(dx.segment<3>(kRotation))).normalized().toRotationMatrix();
  velocity_ += dx.segment<3>(kVelocity);
  T_map_imu_.translation() += dx.segment<3>(kPosition);
  bias_.gyro += dx.segment<3>(kGyro);
  bias_.accel += dx.segment<3>(kAccel);
  gravity_ += dx.segment<3>(kGravityAt);
  return true;
}

void InertialAlignment::transform(const Pose& S_new_old) {
  if (pending_) {
    pending_->T_map_camera = S_new_old * pending_->T_map_camera;
    Matrix6d turn = Matrix6d::Zero();
    turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = S_new_old.linear();
    pending_->covariance = turn * pending_->covariance * turn.transpose();
  }
  Matrix turn = Matrix::Identity();
  for (const Block block : {kVelocity, kPosition, kGravityAt}) turn.block<3, 3>(block, block) = S_new_old.linear();
  P_ = turn * P_ * turn.transpose();
  T_map_imu_ = S_new_old * T_map_imu_;
  velocity_ = S_new_old.linear() * velocity_;
  gravity_ = S_new_old.linear() * gravity_;
}

std::optional<Eigen::Vector3d> InertialAlignment::cameraVelocity(double stamp, const ImuBuffer& imu) const {
  constexpr double kSettled = 0.15;  // standard deviation [m/s]
  if (!kinematics_known_ || stamp < stamp_ || stamp - stamp_ > 0.5 ||
      air_ground_common::largestStddev(P_.block<3, 3>(kVelocity, kVelocity)) > kSettled)
    return std::nullopt;
  Preintegration motion(settings_.noise, bias_);
  if (stamp > stamp_) {
    const std::vector<ImuSample> samples = samplesBetween(imu, stamp_, stamp);
    if (samples.size() < 2) return std::nullopt;
    motion.integrate(samples);
  }
  const ImuBuffer::Mean now = imu.mean(stamp - 0.01, stamp + 0.01);
  if (now.count == 0) return std::nullopt;
  const Eigen::Matrix3d R = T_map_imu_.linear() * motion.rotation();
  const Eigen::Vector3d p_imu_camera = T_camera_imu_.inverse().translation();
  return Eigen::Vector3d(velocity_ + gravity_ * motion.duration() + T_map_imu_.linear() * motion.velocity() +
                         R * (now.angular_velocity - bias_.gyro).cross(p_imu_camera));
}

std::optional<InertialEstimate> InertialAlignment::estimate() const {
  if (!gravity_started_ || poses_ < 2) return std::nullopt;
  // The norm of gravity as one more measurement, iterated: it is not linear.
  Eigen::Vector3d gravity = gravity_;
  Vector dx = Vector::Zero(), K = Vector::Zero();
  double S = 1;
  for (int i = 0; i < 5 && gravity.norm() > 1e-3; ++i) {
    const Eigen::Vector3d H = gravity.normalized();
    const Vector PHt = P_.middleCols<3>(kGravityAt) * H;
    S = H.dot(PHt.segment<3>(kGravityAt)) + square(settings_.gravity_norm_sigma);
    K = PHt / S;
    dx = K * (kGravity - gravity.norm() - H.dot(gravity_ - gravity));
    gravity = gravity_ + dx.segment<3>(kGravityAt);
  }
  if (!(gravity.norm() > 1e-3)) return std::nullopt;
  const Matrix P = std::max(1.0, mean_innovation_) * (P_ - S * K * K.transpose());
  InertialEstimate e;
  e.up = -gravity.normalized();
  const Eigen::Matrix3d tangent = Eigen::Matrix3d::Identity() - e.up * e.up.transpose();
  e.up_sigma = air_ground_common::largestStddev(tangent * P.block<3, 3>(kGravityAt, kGravityAt) * tangent) / kGravity;
  e.velocity = velocity_ + dx.segment<3>(kVelocity);
  e.gyro_bias = bias_.gyro + dx.segment<3>(kGyro);
  e.gyro_bias_sigma = air_ground_common::largestStddev(P.block<3, 3>(kGyro, kGyro));
  e.accel_bias = bias_.accel + dx.segment<3>(kAccel);
  e.poses = poses_;
  return e;
}

}  // namespace visual_frontend
