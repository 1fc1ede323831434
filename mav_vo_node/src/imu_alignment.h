// What the IMU and the feature tracks tell without a map: the gyro's bias, the clocks' offset, the readout time of a
// rolling shutter, how the IMU is turned as mounted, whether the vehicle rests, and which way is up. Outside, all is in
// the axes that the IMU was told to have.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "image_clock_imu.h"
#include "mav_vo/clock_search.h"
#include "mav_vo/odometry.h"
#include "visual_frontend/accel_noise.h"
#include "visual_frontend/imu_attitude.h"

namespace mav_vo {

/// Against gravity, in the IMU's axes.
struct UpDirection {
  Eigen::Vector3d up_imu = Eigen::Vector3d::UnitZ();
  double sigma = 0.1;  ///< [rad]
};

class ImuAlignment {
 public:
  /// Without samples so long the motion between is not known: a packet that was lost [s].
  static constexpr double kLongestGap = 0.09;

  /// `ray_sigma`: of a normalised image coordinate; `rows`: of the images.
  ImuAlignment(const OdometrySettings& settings, const Eigen::Matrix3d& R_camera_imu, double ray_sigma, int rows);

  bool add(const ImuSample& sample);
  void reset();

  /// The IMU seemed to rest before the images began: a hint, no more.
  void useBiasAtRest();
  /// Sees whether there are samples for the time between two images.
  void checkCoverage(double stamp_a, double stamp_b) {
    coverage_.add(imu_.buffer(), imu_.stamp(stamp_a), imu_.stamp(stamp_b));
  }
  /// Up at the next image, `dt` [s] later; the camera turned by `R_previous_current`, none: not known.
  void carryUp(const std::optional<Eigen::Matrix3d>& R_previous_current, double dt);
  /// True when the vehicle rests: gyro bias and up are measured, unless a metric map knows them better.
  bool detectStandstill(double stamp, const std::vector<visual_frontend::Feature>& features, bool metric);
  /// Up as a metric map has it.
  void setUp(const Eigen::Vector3d& up_imu) { up_ = UpDirection{up_imu, kMetricTilt}; }
  const std::optional<UpDirection>& up() const { return up_; }  ///< since a rest, or in a metric map

  /// Readout time that is to replace the one `in_use` [s]; empty: none is sure enough.
  std::optional<double> alignShutter(double stamp, const std::vector<visual_frontend::Feature>& features,
                                     double in_use);
  /// The IMU is surely mounted otherwise than it was taken to be: what it has told is to be turned by this rotation;
  /// empty: as before.
  std::optional<Eigen::Matrix3d> alignMounting(double stamp, const std::vector<visual_frontend::Feature>& features);
  /// True when the estimates of bias and offset changed. A `metric` map knows the bias better than they do.
  bool alignGyro(double stamp, const std::vector<visual_frontend::Feature>& features, bool metric);
  /// The attitude filter follows a bias that is known well enough.
  void followBias(const Eigen::Vector3d& gyro_bias);
  /// True when a sure offset between the clocks replaced the one in use.
  bool adoptTimeOffset();
  /// True when the clocks turn out to be farther apart than the tracks can tell: what gyro and images told of each
  /// other is forgotten, and begins anew there. Looked for until once all offsets have been compared, and in a map that
  /// is not `metric` as long as gyro and images disagree.
  bool findClock(double stamp, bool metric);
  /// A bias from elsewhere, kept where it is better known than the tracks'.
  void keepBias(const Eigen::Vector3d& gyro_bias, double sigma);

  /// R_a_b of the camera between two images' stamps, and its standard deviation; empty where samples are missing.
  std::optional<GyroRotation> cameraTurn(double stamp_a, double stamp_b, const Eigen::Vector3d& gyro_bias) const;
  std::optional<Preintegration> motion(double stamp_a, double stamp_b, const ImuBias& bias) const {
    constexpr double kSlowest = 0.05;  // of an IMU's samples, that tells a vehicle's motion [s]
    return imu_.motion(stamp_a, stamp_b, noise(), bias, coverageProblem().empty() ? kLongestGap : kSlowest);
  }
  /// So that turns are folded down in the gyro, and tell little.
  bool vibrates() const { return accel_noise_.density() > visual_frontend::AccelNoise::kFolded; }
  /// As given, or more where the accelerometer's samples show more.
  ImuNoise noise() const;
  std::string problem() const;  ///< empty: gyro and images agree
  /// Empty: the samples cover most images, or there never were any.
  const std::string& coverageProblem() const { return coverage_.problem(); }
  /// Empty: how far the clocks are apart is known well enough for a scale; else what is missing. Those of clocks
  /// that are farther apart than is looked for end in a false minimum, which mostly never gets sure.
  std::string clockProblem() const;

  double imuStamp(double image_stamp) const { return imu_.stamp(image_stamp); }
  std::optional<UpDirection> attitude(double stamp) const;  ///< by the accelerometer; empty: no samples up to `stamp`
  Eigen::Vector3d gyroBias() const { return imu_.mounting() * trusted().bias(); }  ///< [rad/s]
  double gyroBiasStddev() const { return trusted().biasStddev(); }                 ///< [rad/s]
  double timeOffset() const { return imu_.offset(); }                              ///< in use [s]
  double timeOffsetStddev() const;                                                 ///< 0: given, not estimated [s]
  double readoutTimeStddev() const;                                                ///< likewise [s]
  const Eigen::Matrix3d& mounting() const { return imu_.mounting(); }              ///< R_given_imu in use
  double mountingStddev() const;  ///< of the least certain axis; 0: given, not estimated [rad]

 private:
  const GyroAlignment& trusted() const { return shutter_open_ ? *shutter_alignment_ : gyro_alignment_; }
  bool mountingExplainsMore() const;
  bool mountingIsSteady(double stamp);
  bool clockSearchDue(double stamp, bool metric) const;
  void restartAt(double time_offset);
  bool contradictsShutter() const;

  static constexpr double kMetricTilt = 0.01;  // of the metric map's z axis against gravity [rad]

  OdometrySettings settings_;
  Eigen::Matrix3d R_camera_imu_;
  ImageClockImu imu_{12.0};
  visual_frontend::ImuCoverage coverage_;
  visual_frontend::AccelNoise accel_noise_;
  visual_frontend::AttitudeFilter attitude_;
  GyroAlignment gyro_alignment_;
  std::optional<GyroAlignment> shutter_alignment_;  ///< apart: what it estimates besides makes the others less certain
  bool shutter_open_ = false;  ///< the estimate without the readout time is wrong, as far as one can tell
  std::optional<GyroAlignment> mounting_alignment_;  ///< and this one the mounting
  struct SteadyMounting {
    Eigen::Vector3d value;
    double since;  ///< [s]
  };
  std::optional<SteadyMounting> steady_mounting_;
  bool metric_ = false;
  double last_guess_ = -1;                       ///< of right angles [s]
  std::optional<Eigen::Matrix3d> right_angles_;  ///< R_given_imu by which gyro and images would agree
  struct {
    std::optional<ClockSearch> search;  ///< under way
    double last = -1;                   ///< when the last one began [s]
    int searches = 0;
    bool compared = false;        ///< over a second to either side, and as taken to be
    std::optional<double> apart;  ///< as found once, to be found again [s]
  } clocks_;                      ///< that may be far apart
  StandstillDetector standstill_;
  std::optional<UpDirection> up_;
};

}  // namespace mav_vo
