// Which way is up for a MAV whose odometry tells its turns but nothing of gravity: one without IMU, or not metric yet.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <deque>
#include <limits>
#include <optional>
#include <utility>

#include "air_ground_common/stamped_buffer.h"
#include "ekf_tracker/tilt_source.h"

namespace ekf_tracker {

/// Roll and pitch, and how well they are known.
struct Tilt {
  Eigen::Matrix3d R_level_body = Eigen::Matrix3d::Identity();  ///< without heading
  double stddev = 0;                                           ///< of the vertical about each horizontal axis [rad]
};

/// A Kalman filter over the vertical in the frame of the odometry's first body, where it stands still but for the drift
/// of the turns: measured by the attitudes of fixes, and by the accelerometer, whose accelerations in flight average
/// out over its seconds, but not its bias. Measurements may come before or after the odometry of their time. Not
/// thread-safe. Stamps in seconds.
class TiltFilter {
 public:
  /// Of a vertical by the accelerometer: accelerations of 0.5 m/s^2 [rad].
  static constexpr double kForceStddev = 0.05;

  /// That of a fix.
  struct Vertical {
    double stamp = 0;                                    ///< [s]
    Eigen::Vector3d up_body = Eigen::Vector3d::UnitZ();  ///< any length
    double stddev = 0;                                   ///< about each horizontal axis [rad]
  };

  /// The turn of the body between two stamps, in order; what is not later than the newest is left out. Where the
  /// odometry pauses for less than a second the vertical is known less well after it, else no more.
  void turn(double previous_stamp, double stamp, const Eigen::Matrix3d& R_previous_current);
  /// One is known to 0.01 rad at best. One more than three standard deviations from what is known counts for nothing,
  /// until a third in a row is: then it counts alone.
  void addVertical(const Vertical& vertical);
  /// Specific force in the body [m/s^2].
  void addSpecificForce(double stamp, const Eigen::Vector3d& force_body);

  /// At a stamp of the odometry's last 30 s, or at most `tolerance` beside one [s]; empty while nothing is known.
  std::optional<Tilt> at(double stamp, double tolerance = TiltSource::kSameStamp) const;
  void clear() { *this = TiltFilter(); }

 private:
  void correctByFix(const Vertical& vertical);
  void correctByForces();
  void correct(const Eigen::Vector3d& up_first, double variance, double force_share);
  void set(const Eigen::Vector3d& up_first, double variance, double force_share);
  double angleTo(const Eigen::Vector3d& up_first) const;
  double nis(const Eigen::Vector3d& up_first, double variance) const;

  air_ground_common::StampedBuffer<Eigen::Quaterniond> R_first_body_{30};
  Eigen::Vector3d up_first_ = Eigen::Vector3d::UnitZ();
  double variance_ = std::numeric_limits<double>::infinity();  ///< [rad^2], without the accelerometer's bias
  double force_share_ = 0;          ///< what a bias of the accelerometer is of the vertical's, 0 to 1
  int contradictions_ = 0;          ///< fixes in a row
  std::deque<Vertical> verticals_;  ///< that wait for the odometry of their time
  std::deque<std::pair<double, Eigen::Vector3d>> forces_;  ///< likewise, in the body
  Eigen::Vector3d force_sum_ = Eigen::Vector3d::Zero();    ///< of the first body's axes
  int force_count_ = 0;
  double force_begin_ = 0;  ///< of what is summed up [s]
};

}  // namespace ekf_tracker
