#include "mav_vo/scale_filter.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

namespace mav_vo {

namespace {

constexpr int kP = 0, kV = 3, kB = 6, kG = 9, kS = 11;
constexpr int kMaxRejectedInARow = 10;
constexpr double kAlikeImages = 4;           // in a row that see the same landmarks, and err by them alike
constexpr double kMapVelocityStddev = 0.05;  // of a velocity taken from bundle adjustment [m/s]
constexpr double kDiffuseRatio = 30.0;     // standard deviation of the scale before the start, against the scale itself
constexpr double kMaxRejectedShare = 0.1;  // of the measurements since the start, when the scale counts as certain
constexpr double kSmallTilt = 0.05;        // below, gravity is as good as linear in the tilt [rad]
constexpr double kMaxTiltSine = 0.95;      // of gravity against the map's z axis
constexpr int kMinUpdates = 10;            // since the start, that must confirm it
constexpr double kMaxMeanNis = 2.0;        // since the start, when the scale counts as certain; 1 expected
constexpr double kInvertedStddevs = 5.0;   // of a scale below zero
constexpr double kMaxBiasStddevs = 6.0;    // an accelerometer that is off by more lacks gravity, or has another unit
constexpr double kForcedScaleStddev = 0.1;  // added when a row of rejections forces the motion to start afresh [1]

using ErrorVector = Eigen::Matrix<double, ScaleFilter::kStates, 1>;
using MeasurementMatrix = Eigen::Matrix<double, 3, ScaleFilter::kStates>;

/// Correction K * innovation for measurement noise N; P becomes the posterior (Joseph form), `nis` grows by the
/// squared Mahalanobis distance of the innovation.
ErrorVector kalmanUpdate(const MeasurementMatrix& H, const Eigen::Vector3d& innovation, const Eigen::Matrix3d& N,
                         ScaleFilter::Covariance* P, double* nis = nullptr) {
  const Eigen::Matrix3d S = H * *P * H.transpose() + N;
  if (nis) *nis += innovation.dot(S.ldlt().solve(innovation));
  const Eigen::Matrix<double, ScaleFilter::kStates, 3> K = S.ldlt().solve(H * *P).transpose();
  const ScaleFilter::Covariance A = ScaleFilter::Covariance::Identity() - K * H;
  *P = (A * *P * A.transpose() + K * N * K.transpose()).eval();
  return K * innovation;
}

/// All of the error but the scale, which the linear and the logarithmic form treat differently.
void addError(const ErrorVector& error, ScaleFilter::State* state) {
  state->p += error.segment<3>(kP);
  state->v += error.segment<3>(kV);
  state->accel_bias += error.segment<3>(kB);
  state->gravity_xy += error.segment<2>(kG);
}

/// Derivative of gravity by its horizontal components: its length stays.
Eigen::Matrix<double, 3, 2> gravityJacobian(const Eigen::Vector3d& gravity) {
  Eigen::Matrix<double, 3, 2> D;
  D << 1, 0, 0, 1, -gravity.x() / gravity.z(), -gravity.y() / gravity.z();
  return D;
}

Eigen::Vector3d lever(const ScaleMeasurement& m) { return m.R_map_imu * m.p_imu_camera; }

/// Visual position of the camera: p + exp(-L) R l.
Eigen::Vector3d predictedVisual(const ScaleFilter::State& state, const ScaleMeasurement& m) {
  return state.p + lever(m) / state.scale;
}

/// Its derivative by the error.
MeasurementMatrix measurementMatrix(const ScaleFilter::State& state, const ScaleMeasurement& m) {
  MeasurementMatrix H = MeasurementMatrix::Zero();
  H.block<3, 3>(0, kP) = Eigen::Matrix3d::Identity();
  H.col(kS) = -lever(m) / state.scale;
  return H;
}

}  // namespace

Eigen::Vector3d ScaleFilter::State::gravity() const {
  const double horizontal = std::min(gravity_xy.squaredNorm(), kMaxTiltSine * kMaxTiltSine * kGravity * kGravity);
  return {gravity_xy.x(), gravity_xy.y(), -std::sqrt(kGravity * kGravity - horizontal)};
}

ScaleFilter::ScaleFilter(const ScaleFilterSettings& settings, const ImuNoise& noise, double tilt_stddev)
    : settings_(settings), noise_(noise), tilt_stddev_(tilt_stddev) {
  noise_.validate();
}

void ScaleFilter::reset(double tilt_stddev) {
  tilt_stddev_ = tilt_stddev;
  window_.clear();
  broken_windows_ = 0;
  initialized_ = false;
  state_ = State{};
  P_.setZero();
  rejected_in_a_row_ = 0;
  frames_waited_ = 0;
  updates_ = rejected_updates_ = 0;
  nis_sum_ = 0;
  contradicted_ = inverted_ = false;
  start_stddev_ = std::numeric_limits<double>::infinity();
}

void ScaleFilter::startAt(const ScaleMeasurement& m, const Eigen::Vector3d& velocity, const Eigen::Vector3d& accel_bias,
                          double scale_stddev) {
  state_ = State{};
  state_.p = m.p_map_camera - lever(m);
  state_.v = velocity;
  state_.accel_bias = accel_bias;
  P_ = priorCovariance(m, 1.0, scale_stddev);
  P_.diagonal().segment<3>(kV).setConstant(kMapVelocityStddev * kMapVelocityStddev);
  window_.clear();
  R_before_ = m.R_map_imu;
  stamp_before_ = m.stamp;
  rejected_in_a_row_ = 0;
  updates_ = rejected_updates_ = 0;
  nis_sum_ = 0;
  initialized_ = true;
}

double ScaleFilter::rejectedShare() const {
  return updates_ > 0 ? static_cast<double>(rejected_updates_) / updates_ : 0.0;
}

bool ScaleFilter::certain(double relative_stddev) const {
  return initialized_ && updates_ >= kMinUpdates && relativeStddev() < relative_stddev &&
         rejectedShare() <= kMaxRejectedShare && meanNis() <= kMaxMeanNis;
}

double ScaleFilter::relativeStddev() const {
  return initialized_ ? std::sqrt(P_(kS, kS)) : std::numeric_limits<double>::infinity();
}

double ScaleFilter::scaleStddev() const { return initialized_ ? state_.scale * relativeStddev() : relativeStddev(); }

ScaleFilter::Covariance ScaleFilter::priorCovariance(const ScaleMeasurement& first, double inverse_scale,
                                                     double scale_stddev) const {
  const double speed = inverse_scale * settings_.velocity_stddev, tilt = kGravity * tilt_stddev_;
  Covariance P = Covariance::Zero();
  P.diagonal().segment<3>(kV).setConstant(speed * speed);
  P.diagonal().segment<3>(kB).setConstant(settings_.accel_bias_stddev * settings_.accel_bias_stddev);
  P.diagonal().segment<2>(kG).setConstant(tilt * tilt);
  P(kS, kS) = scale_stddev * scale_stddev;
  seeFirst(first, inverse_scale, &P);
  return P;
}

// The IMU's place follows from the camera's by the lever arm, as long as the scale has it.
void ScaleFilter::seeFirst(const ScaleMeasurement& first, double inverse_scale, Covariance* P) const {
  Covariance J = Covariance::Identity();
  J.topLeftCorner<3, 3>().setZero();
  J.block<3, 1>(kP, kS) = inverse_scale * lever(first);
  *P = (J * *P * J.transpose()).eval();
  P->block<3, 3>(kP, kP) += visualNoise(first);
}

Eigen::Matrix3d ScaleFilter::visualNoise(const ScaleMeasurement& m) const {
  const double sigma = settings_.position_stddev * m.scene_distance;
  return kAlikeImages * m.covariance + sigma * sigma * Eigen::Matrix3d::Identity();
}

ScaleFilter::Covariance ScaleFilter::processNoise(const Preintegration& motion, const Eigen::Matrix3d& R,
                                                  double inverse_scale) const {
  const double dt = motion.duration();
  Covariance Q = Covariance::Zero();
  const auto& C = motion.covariance();
  Q.block<3, 3>(kV, kV) = R * C.block<3, 3>(3, 3) * R.transpose();
  Q.block<3, 3>(kV, kP) = R * C.block<3, 3>(3, 6) * R.transpose();
  Q.block<3, 3>(kP, kV) = R * C.block<3, 3>(6, 3) * R.transpose();
  Q.block<3, 3>(kP, kP) = R * C.block<3, 3>(6, 6) * R.transpose();
  Q.diagonal().segment<3>(kP).array() += settings_.position_drift * settings_.position_drift * dt;
  Q.topLeftCorner<6, 6>() *= inverse_scale * inverse_scale;
  Q.diagonal().segment<3>(kB).setConstant(noise_.accel_bias_walk * noise_.accel_bias_walk * dt);
  const double gravity_walk = kGravity * settings_.rotation_walk;
  Q.diagonal().segment<2>(kG).setConstant(gravity_walk * gravity_walk * dt);
  Q(kS, kS) = settings_.scale_drift * settings_.scale_drift * dt;
  return Q;
}

void ScaleFilter::propagate(const Preintegration& motion, const Eigen::Matrix3d& R, State* state, Covariance* F_out,
                            Covariance* Q) const {
  const double dt = motion.duration(), k = 1 / state->scale;
  const Eigen::Vector3d gravity = state->gravity();
  // Rotation comes from vision, so the deltas use the gyro bias they were integrated at.
  const ImuBias bias{motion.bias().gyro, state->accel_bias};
  const Eigen::Vector3d shift = k * (0.5 * dt * dt * gravity + R * motion.position(bias));
  const Eigen::Vector3d gain = k * (gravity * dt + R * motion.velocity(bias));
  state->p += state->v * dt + shift;
  state->v += gain;

  Covariance& F = *F_out;
  F.setIdentity();
  F.block<3, 3>(kP, kV) = Eigen::Matrix3d::Identity() * dt;
  F.block<3, 3>(kP, kB) = k * R * motion.biasJacobian().block<3, 3>(6, 3);
  F.block<3, 3>(kV, kB) = k * R * motion.biasJacobian().block<3, 3>(3, 3);
  const Eigen::Matrix<double, 3, 2> D = gravityJacobian(gravity);
  F.block<3, 2>(kP, kG) = 0.5 * dt * dt * k * D;
  F.block<3, 2>(kV, kG) = dt * k * D;
  F.block<3, 1>(kP, kS) = -shift;
  F.block<3, 1>(kV, kS) = -gain;
  *Q = processNoise(motion, R, k);
}

void ScaleFilter::add(const ScaleMeasurement& measurement, const std::optional<Preintegration>& motion) {
  if (!measurement.p_map_camera.allFinite() || !measurement.R_map_imu.allFinite() || !(measurement.scene_distance > 0))
    return;
  if (initialized_) {
    if (motion) {
      Covariance F, Q;
      propagate(*motion, R_before_, &state_, &F, &Q);
      P_ = F * P_ * F.transpose() + Q;
      update(measurement);
    } else {
      // Nothing holds the map's scale meanwhile.
      const double dt = std::max(0.0, measurement.stamp - stamp_before_);
      P_(kS, kS) += settings_.scale_drift * settings_.scale_drift * dt;
      restartMotion(measurement);
    }
    R_before_ = measurement.R_map_imu;
    stamp_before_ = measurement.stamp;
    return;
  }
  if (!motion) {
    broken_windows_ += window_.size() > 1;
    window_.clear();
  }
  window_.push_back({measurement, motion});
  double duration = 0;
  for (std::size_t i = 1; i < window_.size(); ++i) duration += window_[i].motion->duration();
  while (window_.size() > 2 && duration - window_[1].motion->duration() > settings_.max_start_duration) {
    duration -= window_[1].motion->duration();
    window_.pop_front();
  }
  // The start solves the whole window, so it is tried at every fifth frame only.
  if (duration < settings_.min_start_duration || ++frames_waited_ % 5 != 0 || !start()) return;
  initialized_ = true;
  R_before_ = measurement.R_map_imu;
  stamp_before_ = measurement.stamp;
  window_.clear();
}

// Over (p, v, k b, k g_xy, k), of which everything is linear where the map leans little. Two passes: the second knows
// the scale with which the priors of what is metric become visual.
std::optional<ScaleFilter::State> ScaleFilter::linearSolution() {
  double guess = 1.0;
  ErrorVector x;
  for (int pass = 0; pass < 2; ++pass) {
    const ScaleMeasurement& first = window_.front().measurement;
    ErrorVector unit = ErrorVector::Ones();  // of the linear states' errors against those of the filter
    unit.segment<5>(kB).setConstant(guess);
    unit(kS) = -guess;
    Covariance P = unit.asDiagonal() * priorCovariance(first, guess, kDiffuseRatio) * unit.asDiagonal();
    x.setZero();
    x(kS) = guess;
    x.segment<3>(kP) = first.p_map_camera - guess * lever(first);
    for (std::size_t i = 1; i < window_.size(); ++i) {
      const ScaleMeasurement& m = window_[i].measurement;
      const Preintegration& motion = *window_[i].motion;
      const Eigen::Matrix3d& R = window_[i - 1].measurement.R_map_imu;
      const double dt = motion.duration();
      const ImuBias bias{motion.bias().gyro, Eigen::Vector3d::Zero()};
      const Eigen::Vector3d gravity(0, 0, -kGravity);
      Covariance F = Covariance::Identity();
      F.block<3, 3>(kP, kV) = Eigen::Matrix3d::Identity() * dt;
      F.block<3, 3>(kP, kB) = R * motion.biasJacobian().block<3, 3>(6, 3);
      F.block<3, 3>(kV, kB) = R * motion.biasJacobian().block<3, 3>(3, 3);
      F(kP, kG) = F(kP + 1, kG + 1) = 0.5 * dt * dt;
      F(kV, kG) = F(kV + 1, kG + 1) = dt;
      F.block<3, 1>(kP, kS) = 0.5 * dt * dt * gravity + R * motion.position(bias);
      F.block<3, 1>(kV, kS) = gravity * dt + R * motion.velocity(bias);
      x = (F * x).eval();
      P = (F * P * F.transpose() + unit.asDiagonal() * processNoise(motion, R, guess) * unit.asDiagonal()).eval();
      MeasurementMatrix H = MeasurementMatrix::Zero();
      H.block<3, 3>(0, kP) = Eigen::Matrix3d::Identity();
      H.col(kS) = lever(m);
      x += kalmanUpdate(H, m.p_map_camera - H * x, visualNoise(m), &P);
    }
    // A sure scale below zero: the accelerations point the other way.
    inverted_ = x(kS) < -kInvertedStddevs * std::sqrt(P(kS, kS));
    if (!(x(kS) > 0) || !x.allFinite()) return std::nullopt;
    guess = x(kS);
  }
  State state;
  state.p = x.segment<3>(kP);
  state.v = x.segment<3>(kV);
  state.accel_bias = x.segment<3>(kB) / guess;
  state.gravity_xy = x.segment<2>(kG) / guess;
  state.scale = 1 / guess;
  return state;
}

bool ScaleFilter::start() {
  const std::optional<State> linear = linearSolution();
  if (!linear) return false;
  // The linear solution takes the length of gravity's vertical part for known: Gauss-Newton about the trajectory it
  // predicts.
  State solution = *linear;
  Covariance P;
  double nis = 0;
  for (int pass = 0; pass < (tilt_stddev_ > kSmallTilt ? 6 : 3); ++pass) {
    nis = 0;
    const ScaleMeasurement& first = window_.front().measurement;
    State nominal = solution;
    nominal.p = first.p_map_camera - lever(first) / solution.scale;
    const Eigen::Vector3d gravity = nominal.gravity();
    for (std::size_t i = 1; i < window_.size(); ++i) {
      const Preintegration& motion = *window_[i].motion;
      const ImuBias bias{motion.bias().gyro, nominal.accel_bias};
      nominal.v -=
          (gravity * motion.duration() + window_[i - 1].measurement.R_map_imu * motion.velocity(bias)) / nominal.scale;
    }
    P = priorCovariance(first, 1 / nominal.scale, kDiffuseRatio);
    ErrorVector error = ErrorVector::Zero();  // mean of the error about the nominal state; the prior means are zero
    error.segment<3>(kV) = -nominal.v;
    error.segment<3>(kB) = -nominal.accel_bias;
    error.segment<2>(kG) = -nominal.gravity_xy;
    for (std::size_t i = 1; i < window_.size(); ++i) {
      const ScaleMeasurement& m = window_[i].measurement;
      Covariance F, Q;
      propagate(*window_[i].motion, window_[i - 1].measurement.R_map_imu, &nominal, &F, &Q);
      error = F * error;
      P = F * P * F.transpose() + Q;
      const MeasurementMatrix H = measurementMatrix(nominal, m);
      const Eigen::Vector3d innovation = m.p_map_camera - predictedVisual(nominal, m) - H * error;
      error += kalmanUpdate(H, innovation, visualNoise(m), &P, &nis);
    }
    if (!error.allFinite() || std::abs(error(kS)) > 1.0) return false;
    addError(error, &nominal);
    nominal.scale *= std::exp(error(kS));
    solution = nominal;
  }
  start_stddev_ = std::sqrt(P(kS, kS));
  if (start_stddev_ > settings_.start_relative_stddev) return false;
  // A sure scale that does not fit: wrong unit, gravity removed, wrong mounting. One term among hundreds of a long
  // window, a bias as large as gravity hardly shows in their mean.
  contradicted_ = nis > settings_.start_max_nis * 3.0 * static_cast<double>(window_.size() - 1) ||
                  solution.accel_bias.norm() > kMaxBiasStddevs * settings_.accel_bias_stddev;
  if (contradicted_) return false;
  state_ = solution;
  P_ = P;
  return true;
}

void ScaleFilter::update(const ScaleMeasurement& m) {
  const MeasurementMatrix H = measurementMatrix(state_, m);
  const Eigen::Matrix3d N = visualNoise(m);
  const Eigen::Vector3d innovation = m.p_map_camera - predictedVisual(state_, m);
  const Eigen::Matrix3d S = H * P_ * H.transpose() + N;
  const double nis = innovation.dot(S.ldlt().solve(innovation));
  ++updates_;
  nis_sum_ += nis < settings_.gate ? nis : settings_.gate;
  if (!(nis < settings_.gate)) {
    ++rejected_;
    ++rejected_updates_;
    // A jump of the visual map (relocalisation) shows as a row of rejections: accept the new place. The scale may be
    // what is wrong.
    if (++rejected_in_a_row_ >= kMaxRejectedInARow) {
      rejected_in_a_row_ = 0;
      P_(kS, kS) += kForcedScaleStddev * kForcedScaleStddev;
      restartMotion(m);
    }
    return;
  }
  rejected_in_a_row_ = 0;
  const ErrorVector dx = kalmanUpdate(H, innovation, N, &P_);
  addError(dx, &state_);
  state_.scale *= std::exp(dx(kS));
}

void ScaleFilter::restartMotion(const ScaleMeasurement& m) {
  const double k = 1 / state_.scale;
  state_.p = m.p_map_camera - k * lever(m);
  state_.v.setZero();
  Covariance J = Covariance::Identity();
  J.block<3, 3>(kV, kV).setZero();
  P_ = (J * P_ * J.transpose()).eval();
  P_.diagonal().segment<3>(kV).array() += std::pow(k * settings_.velocity_stddev, 2);
  seeFirst(m, k, &P_);
}

void ScaleFilter::transform(const air_ground_common::Similarity& S) {
  state_.scale /= S.scale;
  state_.p = S * state_.p;
  state_.v = S.scale * (S.R * state_.v);
  const Eigen::Matrix<double, 3, 2> D = gravityJacobian(state_.gravity());
  state_.gravity_xy = (S.R * state_.gravity()).head<2>();
  R_before_ = S.R * R_before_;
  for (Frame& frame : window_) {
    frame.measurement.p_map_camera = S * frame.measurement.p_map_camera;
    frame.measurement.R_map_imu = S.R * frame.measurement.R_map_imu;
    frame.measurement.scene_distance *= S.scale;
  }
  Covariance T = Covariance::Identity();
  T.block<3, 3>(kP, kP) = T.block<3, 3>(kV, kV) = S.scale * S.R;
  T.block<2, 2>(kG, kG) = S.R.topRows<2>() * D;
  P_ = T * P_ * T.transpose();
}

}  // namespace mav_vo
