// Uniform B-spline of order 6 (degree 5): C^4, so velocity, acceleration and jerk are smooth and exact.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace air_ground_sim {

class QuinticSpline {
 public:
  using Value = Eigen::Vector4d;

  /// Control point i acts around the time start + (i - 2) * interval. Throws std::invalid_argument for fewer than 6.
  QuinticSpline(std::vector<Value> control_points, double start, double interval);

  double begin() const { return start_; }  ///< first time with full support [s]
  double end() const { return start_ + interval_ * static_cast<double>(control_points_.size() - 5); }

  /// The same values a while [s] earlier: its time 0 is this one's time `begin`.
  QuinticSpline beginningAt(double begin) const {
    QuinticSpline later = *this;
    later.start_ -= begin;
    return later;
  }

  /// The derivative of order 0 to 5 with respect to time; `time` is clamped to [begin, end].
  Value evaluate(double time, int derivative = 0) const;

 private:
  std::vector<Value> control_points_;
  double start_, interval_;
  Eigen::Matrix<double, 6, 6> basis_;  // power of u (rows) by control point (columns)
};

}  // namespace air_ground_sim
