// Do gyro and images tell of the same turns? Swapped axes, a wrong mounting or a wrong unit show at once, without
// knowing gravity or where base_link points.
#pragma once

#include <Eigen/Core>
#include <string>

namespace rgbd_slam {

/// Judges every fifty frames in which both turn: the correlation of the two, and how much one turns for the other.
/// A gyro's bias or a lag of some ten milliseconds leave both near one. Not thread-safe.
class RotationCheck {
 public:
  /// Turns over the same time between two frames, rotation vectors in base_link [rad]: by the images, and by the gyro
  /// with its mounting. `seconds`: how long that was.
  void add(const Eigen::Vector3d& seen, const Eigen::Vector3d& felt, double seconds);

  /// What is wrong by the last fifty frames, and what to check; empty while nothing is known to be.
  const std::string& problem() const { return problem_; }
  void reset() { *this = RotationCheck(); }

 private:
  void judge();

  Eigen::Matrix3d seen_seen_ = Eigen::Matrix3d::Zero(), felt_seen_ = Eigen::Matrix3d::Zero();  ///< sums of products
  double felt_felt_ = 0;
  int frames_ = 0;
  std::string problem_;
};

}  // namespace rgbd_slam
