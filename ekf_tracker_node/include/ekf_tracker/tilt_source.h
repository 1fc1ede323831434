// Which way is up at a time: from the poses of the odometry or, where they are absent, from the accelerometer.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "air_ground_common/geometry.h"
#include "air_ground_common/stamped_buffer.h"

namespace ekf_tracker {

/// Roll and pitch alone of R_level_body, whose heading is taken out.
Eigen::Matrix3d tiltOf(const Eigen::Matrix3d& R_level_body);

/// Not thread-safe. Stamps in seconds.
class TiltSource {
 public:
  /// Pose of the body in a level frame. A stamp more than a second before the newest begins afresh, another that is not
  /// later is left out.
  void addPose(double stamp, const air_ground_common::Pose& T_map_base);
  /// Specific force in the body's axes [m/s^2]; a low-pass of one second lets flight accelerations average out.
  void addSpecificForce(double stamp, const Eigen::Vector3d& force_base);

  /// The odometry's pose of this stamp, or the nearest within the tolerance [s].
  std::optional<air_ground_common::Pose> poseAt(double stamp, double tolerance = kSameStamp) const;
  /// Of the odometry [s]; minus infinity without any.
  double newestPose() const { return poses_.newest(); }
  /// R_level_body by the accelerometer; empty where what it feels is not about gravity.
  std::optional<Eigen::Matrix3d> accelerometerTiltAt(double stamp) const;
  /// It has not felt about gravity for so long that no flight explains it: its driver removes gravity, or counts in g.
  bool lacksGravity() const;

  void clear();

  /// Whether a smoothed specific force may be that of a flight with its turns and climbs.
  static bool isGravity(const Eigen::Vector3d& force);

  static constexpr double kSameStamp = 1e-3;  ///< [s]

 private:
  static constexpr double kKept = 30;            // [s]
  static constexpr double kTiltInterval = 0.02;  // of the accelerometer's tilts kept [s]
  static constexpr double kTiltTolerance = 0.2;  // [s]
  // [m/s^2], and how long it may lie beyond [s]
  static constexpr double kLeastGravity = 7, kMostGravity = 13, kLongestManoeuvre = 3;

  air_ground_common::StampedBuffer<air_ground_common::Pose> poses_{kKept};
  air_ground_common::StampedBuffer<Eigen::Vector3d> ups_{kKept};  ///< specific force in the body, smoothed
  Eigen::Vector3d up_base_ = Eigen::Vector3d::Zero();
  std::optional<double> up_stamp_;
  std::optional<double> odd_since_;  ///< up_base_ has not been about gravity [s]
};

}  // namespace ekf_tracker
