// Images that a driver sends again, with new stamps.
#pragma once

#include <sensor_msgs/Image.h>

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <vector>

#include "air_ground_common/imu_combiner.h"

namespace air_ground_common::ros_utils {

/// A camera whose driver hangs, or a converter that fills gaps, sends the pixels of the image before once more. To an
/// estimator that is a robot which has stopped at once. Noise makes two images of a camera differ, but not those of a
/// simulator, whose robot may stand: what tells the two apart is how it came to a stop, and the IMU. Not thread-safe.
class FrozenImages {
 public:
  /// Called with each image in turn, and the IMU's samples since the one before (none: no IMU). True where the pixels
  /// (some thousands of them) are those of the image before, and the robot moves: the last two that differed did so by
  /// more than a robot's that comes to rest, or the IMU is not at rest.
  bool repeats(const sensor_msgs::Image& image, const std::deque<ImuCombiner::Sample>& imu);
  /// Stamp of the first image with these pixels [s].
  double since() const { return since_; }

 private:
  void begin(double stamp, std::vector<std::uint8_t> pixels);
  void listen(const std::deque<ImuCombiner::Sample>& imu);
  bool imuMoves() const;

  std::vector<std::uint8_t> pixels_;  ///< of the last image, some
  double since_ = 0;                  ///< [s]
  double difference_ = 0;             ///< of the last two images that differed, the mean over the pixels [grey levels]
  // Since then: means of some samples in a row, and between what they lie.
  ImuCombiner::Sample sum_;
  int in_sum_ = 0, means_ = 0;
  Eigen::Array<double, 6, 1> least_, most_;  ///< angular velocity [rad/s], force [m/s^2]
};

}  // namespace air_ground_common::ros_utils
