#include "flown_level.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace mav_vo {

air_ground_common::Vertical verticalOfFlight(const std::vector<FlownAttitude>& attitudes) {
  constexpr double kMaxRoll = 0.2;       // root mean square: more is no level flight, or a camera on its side [rad]
  constexpr double kLeastTurn = 0.2;     // root mean square of the heading: who turns less may roll as much [rad]
  constexpr double kSystematic = 0.02;   // a mean roll: wind, a camera that sits askew [rad]
  constexpr double kMaxDeviation = 0.1;  // [rad]
  air_ground_common::Vertical vertical;
  if (attitudes.empty()) return vertical;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  Eigen::Vector3d below = Eigen::Vector3d::Zero();
  double independent = 0, last = attitudes.front().stamp - 1;
  for (const FlownAttitude& a : attitudes) {
    // Many keyframes of one second are one attitude.
    const double weight = std::clamp(a.stamp - last, 0.0, 1.0);
    last = a.stamp;
    scatter += weight * a.lateral * a.lateral.transpose();
    below += weight * a.below;
    independent += weight;
  }
  if (!(independent > 0)) return vertical;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(scatter / independent);
  const double roll = std::sqrt(std::max(0.0, axes.eigenvalues()(0)));
  if (roll > kMaxRoll) return vertical;
  const double turned = std::sqrt(std::max(0.0, axes.eigenvalues()(1)));
  if (turned < kLeastTurn) return vertical;
  const double deviation = std::hypot(roll, kSystematic) / (std::sqrt(independent) * turned);
  const Eigen::Vector3d up = axes.eigenvectors().col(0);
  const double side = up.dot(below);
  if (deviation > kMaxDeviation || side == 0) return vertical;
  vertical.up = side < 0 ? up : -up;
  vertical.stddev = std::hypot(deviation, kSystematic);
  return vertical;
}

}  // namespace mav_vo
