#include "air_ground_sim/spline.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace air_ground_sim {
namespace {

double binomial(int n, int k) {
  double b = 1;
  for (int i = 1; i <= k; ++i) b = b * (n - k + i) / i;
  return b;
}

}  // namespace

QuinticSpline::QuinticSpline(std::vector<Value> control_points, double start, double interval)
    : control_points_(std::move(control_points)), start_(start), interval_(interval) {
  if (control_points_.size() < 6) throw std::invalid_argument("a quintic spline needs at least 6 control points");
  if (!(interval > 0)) throw std::invalid_argument("the spline's interval must be positive");
  // Matrix form of uniform B-splines (Qin, "General matrix representations for B-splines", 1998).
  constexpr int k = 6;
  const double factorial = 120;
  for (int power = 0; power < k; ++power)
    for (int j = 0; j < k; ++j) {
      double sum = 0;
      for (int s = j; s < k; ++s)
        sum += ((s - j) % 2 ? -1.0 : 1.0) * binomial(k, s - j) * std::pow(k - s - 1, k - 1 - power);
      basis_(power, j) = binomial(k - 1, k - 1 - power) / factorial * sum;
    }
}

QuinticSpline::Value QuinticSpline::evaluate(double time, int derivative) const {
  const double t = std::clamp((time - start_) / interval_, 0.0, static_cast<double>(control_points_.size() - 5));
  const int i = std::min(static_cast<int>(t), static_cast<int>(control_points_.size()) - 6);
  const double u = t - i;
  Eigen::Matrix<double, 1, 6> powers = Eigen::Matrix<double, 1, 6>::Zero();
  double factor[6] = {1, 1, 1, 1, 1, 1};
  for (int p = 0; p < 6; ++p)
    for (int d = 0; d < derivative; ++d) factor[p] *= p - d;
  double up = 1;
  for (int p = derivative; p < 6; ++p, up *= u) powers(p) = factor[p] * up;
  const Eigen::Matrix<double, 1, 6> weights = powers * basis_;
  Value v = Value::Zero();
  for (int j = 0; j < 6; ++j) v += weights(j) * control_points_[i + j];
  return v / std::pow(interval_, derivative);
}

}  // namespace air_ground_sim
