// Clocks of images and IMU that are farther apart than an estimate that starts near zero can tell: it would end in a
// false minimum.
#pragma once

#include <limits>
#include <optional>
#include <vector>

#include "mav_vo/gyro_alignment.h"

namespace mav_vo {

/// Tries time offsets of up to a second to either side, each with biases of its own. All of them take as long as fifty
/// images: a few are tried with each image, on the pairs and samples there were at the beginning.
class ClockSearch {
 public:
  /// Empty: too few pairs that have samples whatever the offset is.
  static std::optional<ClockSearch> begin(const GyroAlignment& alignment, const ImuBuffer& imu);

  /// Tries so many more; true when none is left.
  bool advance(int offsets);

  /// When none is left: t_imu - t_image with which gyro and images agree, where they do nearly as well with no other
  /// [s].
  std::optional<double> found() const;

 private:
  struct Minimum {
    double offset = 0, cost = std::numeric_limits<double>::infinity();
  };
  ClockSearch(const GyroAlignment& alignment, const ImuBuffer& imu);

  GyroAlignment alignment_;
  ImuBuffer imu_;
  int tried_ = 0;
  std::vector<Minimum> minima_;
  Minimum best_;
  double misfit_ = 0;  // there
};

}  // namespace mav_vo
