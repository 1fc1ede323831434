// One stream of IMU samples from a gyro and an accelerometer that are published apart, each at a rate of its own.
#pragma once

#include <Eigen/Core>
#include <deque>
#include <optional>

namespace air_ground_common {

/// Beyond what the IMU of any robot can read: such a sample was spoilt on its way, or is in another unit.
constexpr double kMaxAngularVelocity = 100;  ///< [rad/s]
constexpr double kMaxSpecificForce = 2000;   ///< [m/s^2]

/// Samples at the gyro's stamps, the specific force interpolated linearly between the accelerometer's two around each.
/// Stamps in seconds, in order within each stream; one that is not later than the last is left out, and one that is a
/// second earlier begins afresh (a recording that is played again). Not thread-safe.
class ImuCombiner {
 public:
  struct Sample {
    double stamp = 0;
    Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
    Eigen::Vector3d specific_force = Eigen::Vector3d::Zero();
  };

  void addGyro(double stamp, const Eigen::Vector3d& angular_velocity) {
    if (admit(gyro_, stamp)) gyro_.push_back({stamp, angular_velocity});
  }

  void addAccelerometer(double stamp, const Eigen::Vector3d& specific_force) {
    if (admit(accelerometer_, stamp)) accelerometer_.push_back({stamp, specific_force});
  }

  /// The next sample that is complete. A gyro's before the first of the accelerometer is left out.
  std::optional<Sample> pop() {
    while (!gyro_.empty() && accelerometer_.size() > 1) {
      const double t = gyro_.front().stamp;
      while (accelerometer_.size() > 2 && accelerometer_[1].stamp < t) accelerometer_.pop_front();
      if (accelerometer_[1].stamp < t) return std::nullopt;
      const Reading reading = gyro_.front();
      gyro_.pop_front();
      const Reading &a = accelerometer_[0], &b = accelerometer_[1];
      if (t < a.stamp) continue;
      const double part = (t - a.stamp) / (b.stamp - a.stamp);
      return Sample{t, reading.value, a.value + part * (b.value - a.value)};
    }
    return std::nullopt;
  }

  void clear() {
    gyro_.clear();
    accelerometer_.clear();
  }

 private:
  struct Reading {
    double stamp;
    Eigen::Vector3d value;
  };

  bool admit(std::deque<Reading>& readings, double stamp) {
    constexpr double kAfresh = 1.0;       // [s]
    constexpr std::size_t kMost = 20000;  // some 20 s
    if (!readings.empty() && stamp < readings.back().stamp - kAfresh) clear();
    if (!readings.empty() && stamp <= readings.back().stamp) return false;
    if (readings.size() >= kMost) readings.pop_front();
    return true;
  }

  std::deque<Reading> gyro_, accelerometer_;
};

}  // namespace air_ground_common
