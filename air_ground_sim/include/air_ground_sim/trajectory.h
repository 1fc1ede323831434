// Ways of the two robots: position and yaw on a C^4 spline, the attitude of the MAV as a quadrotor must hold it.
#pragma once

#include <cstdint>
#include <functional>

#include "air_ground_common/geometry.h"
#include "air_ground_sim/config.h"
#include "air_ground_sim/random.h"
#include "air_ground_sim/spline.h"

namespace air_ground_sim {

constexpr double kGravity = 9.80665;  ///< [m/s^2]

struct BodyState {
  air_ground_common::Pose T_world_body = air_ground_common::Pose::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();              ///< in world [m/s]
  Eigen::Vector3d acceleration = Eigen::Vector3d::Zero();          ///< in world [m/s^2]
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();      ///< of body, in body [rad/s]
  Eigen::Vector3d angular_acceleration = Eigen::Vector3d::Zero();  ///< of body, in body [rad/s^2]
};

/// Position and yaw (x, y, z, yaw) over time. A flying body tilts so that its z axis carries thrust: parallel to
/// acceleration minus gravity (Mellinger, Kumar 2011); a driving one stays level.
class BodyTrajectory {
 public:
  BodyTrajectory(QuinticSpline spline, bool flies) : spline_(std::move(spline)), flies_(flies) {}

  /// Time is clamped to the trajectory's span.
  BodyState state(double time) const;
  air_ground_common::Pose pose(double time) const;
  const QuinticSpline& spline() const { return spline_; }
  double pathLength(double from, double to) const;  ///< [m]
  /// What is left from the time `begin` on [s], which becomes time 0.
  BodyTrajectory beginningAt(double begin) const { return BodyTrajectory(spline_.beginningAt(begin), flies_); }

 private:
  void attitude(double time, Eigen::Matrix3d* R, Eigen::Vector3d* omega) const;
  QuinticSpline spline_;
  bool flies_;
};

/// Height [m] of the highest thing within a radius [m] of a place.
using ClearanceMap = std::function<double(const Eigen::Vector2d&, double)>;

/// The pilot's corrections: two incommensurate sines an axis.
class Sway {
 public:
  Sway(double amplitude, double period, Rng* rng);  ///< [m], [s]
  void add(double envelope, double time, Eigen::Vector3d* position) const;

 private:
  double amplitude_[3][2], period_[3][2], phase_[3][2];
};

/// Stand still, climb with lateral excitation, loops around the centre. `start` is the take-off place; same seed, same
/// way.
BodyTrajectory makeFlight(const FlightConfig& config, const Eigen::Vector2d& start, const ClearanceMap& clearance,
                          std::uint64_t seed);

/// The ground robot (omnidirectional) follows the lane's smoothed points within [0, duration], facing look_at.
BodyTrajectory makeDrive(const LaneConfig& lane, double duration, std::uint64_t seed);

/// Spline whose control points are samples of f(time), [0, duration] [s]: smooth where f has steps in its derivatives.
QuinticSpline splineAlong(double duration, const std::function<Eigen::Vector4d(double)>& f);

/// 0 to 1 over [0, 1], clamped outside, with vanishing first and second derivatives at both ends.
double smoothStep(double x);

constexpr double kClimbTime = 6.0;        ///< of a flight, after standing still [s]
constexpr double kDriveRamp = 1.5;        ///< of a drive, from rest to its speed [s]
constexpr double kStandingHeight = 0.10;  ///< base_link of the MAV above the floor before take-off [m]

/// Points of a Catmull-Rom curve through `points`, every ~1 cm.
std::vector<Eigen::Vector2d> smoothLane(const std::vector<Eigen::Vector2d>& points);

}  // namespace air_ground_sim
