// Readings that a sensor cut off at the end of its range.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace air_ground_common {

/// Tells from the readings of three axes where the range ends: what would lie beyond is read as the same number again
/// and again, and hardly anything just below it.
class RangeEnd {
 public:
  /// `least`: no range ends below [unit of the readings].
  explicit RangeEnd(double least) : least_(least) {}

  /// True for a reading that has an axis at the end of its range, once ten were.
  bool reached(const Eigen::Vector3d& reading) {
    bool reached = false;
    for (int i = 0; i < 3; ++i) reached = add(axes_[i], std::abs(reading[i])) || reached;
    return reached;
  }

  /// The largest number read [unit of the readings].
  double largest() const { return std::max({axes_[0].largest, axes_[1].largest, axes_[2].largest}); }

 private:
  struct Axis {
    double largest = 0;             ///< size of a reading
    std::size_t at = 0, below = 0;  ///< readings of that size, and within 2 % below it
  };

  bool add(Axis& axis, double size) const {
    constexpr double kSame = 1e-4, kBelow = 0.02;  // relative; a step of 16 bits is 3e-5
    constexpr std::size_t kOften = 10;
    if (size > (1 + kSame) * axis.largest) {
      axis.below = (1 - kBelow) * size <= axis.largest ? axis.at + axis.below : 0;
      axis.largest = size;
      axis.at = 0;
    }
    if (size >= (1 - kSame) * axis.largest) {
      ++axis.at;
      return axis.largest >= least_ && axis.at >= kOften && axis.at > axis.below;
    }
    axis.below += size >= (1 - kBelow) * axis.largest;
    return false;
  }

  double least_;
  std::array<Axis, 3> axes_;
};

}  // namespace air_ground_common
