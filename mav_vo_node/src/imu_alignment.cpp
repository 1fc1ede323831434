#include "imu_alignment.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "air_ground_common/geometry.h"
#include "air_ground_common/text.h"

namespace mav_vo {

namespace {

constexpr double kImuRestBiasSigma = 0.01;    // of a gyro bias that the IMU alone calls a rest [rad/s]
constexpr double kRestBiasSigma = 1e-3;       // of one measured at rest [rad/s]
constexpr double kUsefulBiasSigma = 0.02;     // of a bias that the attitude filter takes over [rad/s]
constexpr double kRestTilt = 0.012;           // of gravity measured at rest [rad]
constexpr double kOffsetSigma = 0.004;        // a better known time offset is used [s]
constexpr double kOpenOffsetSigma = 0.012;    // ... or one not known so well, that rules the one in use out [s]
constexpr double kRuledOut = 4;               // by so many standard deviations
constexpr double kOffsetStep = 5e-4;          // smaller changes of it are not worth the work [s]
constexpr double kReadoutSigma = 4e-3;        // of a readout time that is taken over [s]
constexpr double kOpenReadoutSigma = 0.01;    // ... or of one not known so well, that rules the one in use out [s]
constexpr double kReadoutStep = 4e-3;         // least change of it [s]
constexpr double kReadoutRefinement = 1e-3;   // least change of one that was estimated [s]
constexpr double kShutterMisfit = 2;          // of noise; above, the tracks are not explained by a readout time
constexpr double kChi2Of3 = 16.27;            // 3 degrees of freedom, 99.9 %
constexpr double kMeanChi2Of3 = 3;            // likewise, the mean: an estimate that has become better by as much
constexpr double kMountingStep = 0.0175;      // least turn of an IMU against its mounting as told [rad]
constexpr double kMountingRefinement = 4e-3;  // ... and of one that was estimated [rad]
constexpr double kGyroMisfit = 4;             // of noise; above, gyro and images contradict each other
constexpr double kMountingSteady = 2;         // for which a first one has been about the same [s]
constexpr double kMountingWander = 1.0 / 3;   // of itself, that it may change meanwhile
constexpr double kMountingGain = 0.8;         // a first turn must cut the misfit to this share of the best without it
constexpr int kMountingTracks = 50;           // of a pair; there is time to find it
constexpr double kGuessInterval = 3;          // between guesses of axes that were taken for each other [s]
constexpr double kClockInterval = 2;          // between searches for clocks that are far apart [s]
constexpr double kClockReach = 0.1;           // nearer ones the tracks find [s]
constexpr double kSameClock = 0.03;           // of two searches that agree [s]
constexpr double kGoodMisfit = 1;             // of noise; below, gyro and images agree
constexpr int kOffsetsPerImage = 2;           // that a search for clocks tries
constexpr int kMostClockSearches = 5;         // that tell nothing, where nothing else speaks for a difference
constexpr double kKnownOffset = 0.01;  // standard deviation of the offset between the clocks, enough for a scale [s]
constexpr double kCloseMisfit = 0.5;   // of a gyro that fits so well that another offset cannot matter

/// Of a unit vector along an axis: "-y".
std::string axisName(const Eigen::Vector3d& axis) {
  int largest = 0;
  axis.cwiseAbs().maxCoeff(&largest);
  return std::string(axis(largest) < 0 ? "-" : "") + "xyz"[largest];
}

/// Images that are flipped turn as if the camera stood on its head (left to right) or looked behind itself (top to
/// bottom).
std::string flipOf(const Eigen::Matrix3d& R_given_actual) {
  constexpr double kNear = 0.94;  // cosine of 20 degrees
  const auto halfTurnAbout = [&](int axis) {
    return R_given_actual(axis, axis) > kNear && R_given_actual.trace() < -kNear;
  };
  if (halfTurnAbout(0)) return ", or have the images not mirrored left to right";
  if (halfTurnAbout(1)) return ", or have the images not mirrored top to bottom";
  return "";
}

}  // namespace

ImuAlignment::ImuAlignment(const OdometrySettings& settings, const Eigen::Matrix3d& R_camera_imu, double ray_sigma,
                           int rows)
    : settings_(settings),
      R_camera_imu_(R_camera_imu),
      gyro_alignment_(settings.gyro_alignment, settings.imu_noise, R_camera_imu, ray_sigma, rows),
      standstill_(settings.standstill) {
  GyroAlignmentSettings open = settings.gyro_alignment;
  open.readout_time = settings.readout_time;
  open.readout_time_stddev = settings.readout_time_stddev;
  if (settings.readout_time_stddev > 0)
    shutter_alignment_.emplace(open, settings.imu_noise, R_camera_imu, ray_sigma, rows);
  open.mounting_stddev = settings.imu_rotation_stddev;
  open.max_tracks = kMountingTracks;
  if (settings.imu_rotation_stddev > 0)
    mounting_alignment_.emplace(open, settings.imu_noise, R_camera_imu, ray_sigma, rows);
  reset();
}

bool ImuAlignment::add(const ImuSample& sample) {
  if (!imu_.add(sample)) return false;
  attitude_.add(sample);
  accel_noise_.add(sample.stamp, sample.specific_force);
  return true;
}

ImuNoise ImuAlignment::noise() const {
  ImuNoise noise = settings_.imu_noise;
  noise.accel_density = std::max(noise.accel_density, accel_noise_.density());
  return noise;
}

void ImuAlignment::reset() {
  imu_.clear();
  coverage_.reset();
  accel_noise_.reset();
  attitude_.reset();
  gyro_alignment_.setMounting(Eigen::Vector3d::Zero());
  gyro_alignment_.setReadoutTime(settings_.readout_time);
  if (shutter_alignment_) shutter_alignment_->setMounting(Eigen::Vector3d::Zero());
  if (mounting_alignment_) mounting_alignment_->setMounting(Eigen::Vector3d::Zero());
  imu_.setMounting(Eigen::Matrix3d::Identity());
  restartAt(settings_.gyro_alignment.time_offset);
  metric_ = false;
  standstill_.reset();
  up_.reset();
}

void ImuAlignment::restartAt(double time_offset) {
  gyro_alignment_.restartAt(time_offset);
  if (shutter_alignment_) shutter_alignment_->restartAt(time_offset);
  if (mounting_alignment_) mounting_alignment_->restartAt(time_offset);
  imu_.setOffset(time_offset);
  shutter_open_ = false;
  steady_mounting_.reset();
  last_guess_ = -1;
  right_angles_.reset();
  clocks_ = {};
}

bool ImuAlignment::clockSearchDue(double stamp, bool metric) const {
  if (settings_.gyro_alignment.time_offset_stddev <= 0 || stamp - clocks_.last < kClockInterval) return false;
  if (clocks_.apart || (!clocks_.compared && clocks_.searches < kMostClockSearches)) return true;
  return !metric && (trusted().misfit() > kGoodMisfit || !clockProblem().empty());
}

bool ImuAlignment::findClock(double stamp, bool metric) {
  if (!clocks_.search) {
    if (!clockSearchDue(stamp, metric)) return false;
    clocks_.search = ClockSearch::begin(shutter_alignment_ ? *shutter_alignment_ : gyro_alignment_, imu_.buffer());
    if (!clocks_.search) return false;
    clocks_.last = stamp;
    ++clocks_.searches;
  }
  if (!clocks_.search->advance(kOffsetsPerImage)) return false;
  const auto found = clocks_.search->found(), before = std::exchange(clocks_.apart, std::nullopt);
  clocks_.search.reset();
  if (!found) return false;
  if (std::abs(*found - gyro_alignment_.givenTimeOffset()) < kClockReach) {
    clocks_.compared = true;
    return false;
  }
  clocks_.apart = found;
  if (!before || std::abs(*before - *found) > kSameClock) return false;
  restartAt(*found);
  return true;
}

void ImuAlignment::useBiasAtRest() {
  if (attitude_.biasKnown()) gyro_alignment_.setBias(attitude_.gyroBias(), kImuRestBiasSigma);
}

void ImuAlignment::carryUp(const std::optional<Eigen::Matrix3d>& R_previous_current, double dt) {
  if (!up_) return;
  if (!R_previous_current) {
    // The IMU had a gap: what the vehicle did meanwhile is not known.
    up_.reset();
    return;
  }
  up_->up_imu =
      (R_camera_imu_.transpose() * R_previous_current->transpose() * R_camera_imu_ * up_->up_imu).normalized();
  up_->sigma = std::min(0.5, up_->sigma + std::max(kRestBiasSigma, gyroBiasStddev()) * dt);
}

bool ImuAlignment::detectStandstill(double stamp, const std::vector<visual_frontend::Feature>& features, bool metric) {
  const auto rest = standstill_.add(stamp, features, imu_.buffer(), imu_.stamp(stamp));
  // Once the map is metric its own estimate is better than a short rest in the air.
  if (!rest || metric) return false;
  gyro_alignment_.setBias(rest->gyro_bias, kRestBiasSigma);
  if (shutter_alignment_) shutter_alignment_->setBias(rest->gyro_bias, kRestBiasSigma);
  if (mounting_alignment_) mounting_alignment_->setBias(rest->gyro_bias, kRestBiasSigma);
  attitude_.setGyroBias(rest->gyro_bias);
  up_ = UpDirection{imu_.mounting() * rest->up_imu, kRestTilt};
  return true;
}

std::optional<double> ImuAlignment::alignShutter(double stamp, const std::vector<visual_frontend::Feature>& features,
                                                 double in_use) {
  if (!shutter_alignment_ || !shutter_alignment_->add(stamp, features, imu_.buffer())) return std::nullopt;
  // Broken images or samples tell of no camera.
  if (shutter_alignment_->misfit() > kShutterMisfit) return std::nullopt;
  const double readout = shutter_alignment_->readoutTime(), sigma = shutter_alignment_->readoutTimeStddev();
  const bool known = sigma < kReadoutSigma;
  if (!known && (sigma > kOpenReadoutSigma || mountingExplainsMore())) return std::nullopt;
  double least = kRuledOut * sigma;
  if (known) least = in_use != 0 ? std::max(kReadoutRefinement, sigma) : std::max(kReadoutStep, 3 * sigma);
  if (std::abs(readout - in_use) < least) return std::nullopt;
  gyro_alignment_.setReadoutTime(readout);
  return readout;
}

// What else an IMU and images can do to each other bends the mounting's estimate too, but then it explains no more than
// they do.
bool ImuAlignment::mountingExplainsMore() const {
  if (!mounting_alignment_) return false;
  double others = gyro_alignment_.misfit();
  if (shutter_alignment_) others = std::min(others, shutter_alignment_->misfit());
  return mounting_alignment_->misfit() <= kMountingGain * others;
}

// While little is known, what else an IMU and images do to each other makes an estimate that looks sure, and wanders.
bool ImuAlignment::mountingIsSteady(double stamp) {
  const Eigen::Vector3d mounting = mounting_alignment_->mounting();
  if (!steady_mounting_ || (mounting - steady_mounting_->value).norm() > kMountingWander * mounting.norm())
    steady_mounting_ = SteadyMounting{mounting, stamp};
  return stamp - steady_mounting_->since > kMountingSteady;
}

std::optional<Eigen::Matrix3d> ImuAlignment::alignMounting(double stamp,
                                                           const std::vector<visual_frontend::Feature>& features) {
  if (!mounting_alignment_ || !mounting_alignment_->add(stamp, features, imu_.buffer()) ||
      mounting_alignment_->misfit() > kShutterMisfit)
    return std::nullopt;
  if (vibrates()) return std::nullopt;
  const Eigen::Vector3d mounting = mounting_alignment_->mounting(), in_use = gyro_alignment_.mounting();
  const Eigen::Vector3d change = mounting - in_use;
  const double nis = change.dot(mounting_alignment_->mountingCovariance().ldlt().solve(change));
  const bool first = in_use.isZero();
  if (first && (!mountingIsSteady(stamp) || !mountingExplainsMore())) return std::nullopt;
  if (change.norm() < (first ? kMountingStep : kMountingRefinement) || nis < (first ? kChi2Of3 : kMeanChi2Of3))
    return std::nullopt;
  const Eigen::Matrix3d before = imu_.mounting();
  imu_.setMounting(air_ground_common::expSO3(mounting));
  gyro_alignment_.setMounting(mounting);
  if (shutter_alignment_) shutter_alignment_->setMounting(mounting);
  const Eigen::Matrix3d turn = imu_.mounting() * before.transpose();
  if (up_) up_->up_imu = (turn * up_->up_imu).eval();
  return turn;
}

bool ImuAlignment::alignGyro(double stamp, const std::vector<visual_frontend::Feature>& features, bool metric) {
  const bool changed = gyro_alignment_.add(stamp, features, imu_.buffer());
  if (changed) {
    metric_ = metric;
    shutter_open_ = !metric && shutter_alignment_ && contradictsShutter();
  }
  if (trusted().misfit() < kGyroMisfit) {
    right_angles_.reset();
  } else if (stamp - last_guess_ > kGuessInterval) {
    last_guess_ = stamp;
    right_angles_ = gyro_alignment_.rightAngles(imu_.buffer());
  }
  return changed;
}

void ImuAlignment::followBias(const Eigen::Vector3d& gyro_bias) {
  if (gyroBiasStddev() < kUsefulBiasSigma) attitude_.setGyroBias(imu_.mounting().transpose() * gyro_bias);
}

bool ImuAlignment::adoptTimeOffset() {
  // A wrong mounting, too, makes turns come late. Misfit 0: of nothing yet.
  const double misfit = mounting_alignment_ ? mounting_alignment_->misfit() : 0;
  const bool by_mounting = misfit > 0 && misfit <= kMountingGain * trusted().misfit();
  const GyroAlignment& clocks = by_mounting ? *mounting_alignment_ : trusted();
  const double offset = clocks.timeOffset(), sigma = clocks.timeOffsetStddev();
  const double change = std::abs(offset - imu_.offset());
  if (sigma > (metric_ ? kOffsetSigma : kOpenOffsetSigma) ||
      change < std::max(kOffsetStep, (sigma > kOffsetSigma ? kRuledOut : 2) * sigma))
    return false;
  imu_.setOffset(offset);
  return true;
}

void ImuAlignment::keepBias(const Eigen::Vector3d& gyro_bias, double sigma) {
  if (sigma < gyroBiasStddev()) gyro_alignment_.setBias(imu_.mounting().transpose() * gyro_bias, sigma);
}

std::optional<GyroRotation> ImuAlignment::cameraTurn(double stamp_a, double stamp_b,
                                                     const Eigen::Vector3d& gyro_bias) const {
  const auto R = imu_.rotation(stamp_a, stamp_b, gyro_bias);
  if (!R) return std::nullopt;
  const double duration = stamp_b - stamp_a;
  const double rate = air_ground_common::rotationAngle(Eigen::Matrix3d::Identity(), *R) / duration;
  return GyroRotation{R_camera_imu_ * *R * R_camera_imu_.transpose(),
                      std::hypot(gyroBiasStddev() * duration, trusted().timeOffsetStddev() * rate)};
}

// After Hausman, with the wider covariance alone, which is cautious: a readout time that is taken for known makes the
// estimate surer, and wrong where it is not true.
bool ImuAlignment::contradictsShutter() const {
  const Eigen::Vector3d difference = shutter_alignment_->bias() - gyro_alignment_.bias();
  return difference.dot(shutter_alignment_->biasCovariance().ldlt().solve(difference)) > kChi2Of3;
}

std::string ImuAlignment::problem() const {
  if (trusted().misfit() < kGyroMisfit) return "";
  if (right_angles_)
    return air_ground_common::formatted(
        "gyro and images turn differently: the x, y and z axes of the IMU seem to be %s, %s and %s of its frame: "
        "correct its static transform (or the camera's)%s",
        axisName(right_angles_->col(0)).c_str(), axisName(right_angles_->col(1)).c_str(),
        axisName(right_angles_->col(2)).c_str(),
        flipOf(R_camera_imu_ * *right_angles_ * R_camera_imu_.transpose()).c_str());
  return air_ground_common::formatted(
      "gyro and images turn differently (%.0f times the tracks' noise): check the static transforms of IMU and "
      "camera, the gyro's unit (rad/s), time stamps, rolling shutter (readout_time)",
      trusted().misfit());
}

std::string ImuAlignment::clockProblem() const {
  const double misfit = trusted().misfit();  // 0: of nothing yet
  if (timeOffsetStddev() < kKnownOffset || (misfit > 0 && misfit < kCloseMisfit)) return "";
  return air_ground_common::formatted(
      "how far the clocks of images and IMU are apart is not known yet (+- %.0f ms): turn the camera; if that does not "
      "help, have both drivers stamp when they measure, or set time_offset (t_imu - t_image) and time_offset_stddev: 0",
      1e3 * timeOffsetStddev());
}

double ImuAlignment::timeOffsetStddev() const {
  return settings_.gyro_alignment.time_offset_stddev > 0 ? trusted().timeOffsetStddev() : 0;
}

double ImuAlignment::readoutTimeStddev() const {
  return shutter_alignment_ ? shutter_alignment_->readoutTimeStddev() : 0;
}

double ImuAlignment::mountingStddev() const {
  return mounting_alignment_ ? std::sqrt(mounting_alignment_->mountingCovariance().diagonal().maxCoeff()) : 0;
}

std::optional<UpDirection> ImuAlignment::attitude(double stamp) const {
  if (!attitude_.knownAt(imu_.stamp(stamp))) return std::nullopt;
  return UpDirection{imu_.mounting() * attitude_.up(), attitude_.upSigma()};
}

}  // namespace mav_vo
