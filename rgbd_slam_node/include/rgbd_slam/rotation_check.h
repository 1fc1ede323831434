// Do gyro and images tell of the same turns? Swapped axes, a wrong mounting or a wrong unit show at once, without
// knowing gravity or where base_link points.
#pragma once

#include <Eigen/Core>
#include <string>

namespace rgbd_slam {

/// Judges every fifty turns, each of a tenth of a second or one frame where those are longer: the correlation of the
/// two, and how much one turns for the other. A gyro's bias or a lag of some ten milliseconds leave both near one; a
/// turn that the images alone show counts where no bias can hide it. Not thread-safe.
class RotationCheck {
 public:
  /// Turns over the same time between two frames, rotation vectors in base_link [rad]: by the images, and by the gyro
  /// with its mounting. `seconds`: how long that was.
  void add(const Eigen::Vector3d& seen, const Eigen::Vector3d& felt, double seconds);

  /// What is wrong by the last fifty turns, and what to check; empty while nothing is known to be.
  const std::string& problem() const { return problem_; }
  void reset() { *this = RotationCheck(); }

 private:
  void addTurn(const Eigen::Vector3d& seen, const Eigen::Vector3d& felt, double seconds);
  void judge();

  Eigen::Vector3d seen_ = Eigen::Vector3d::Zero(), felt_ = Eigen::Vector3d::Zero();  ///< so far in this turn [rad]
  double seconds_ = 0;                                                               ///< of it
  Eigen::Matrix3d seen_seen_ = Eigen::Matrix3d::Zero(), felt_seen_ = Eigen::Matrix3d::Zero();  ///< sums of products
  double felt_felt_ = 0;
  int turns_ = 0;
  std::string problem_;
};

}  // namespace rgbd_slam
