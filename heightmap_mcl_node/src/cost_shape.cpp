#include "cost_shape.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <vector>

namespace heightmap_mcl {
namespace {

double costAfter(const DirectCost& cost, const AerialCells& cells, const Placement& from, const Eigen::Vector3d& d,
                 const CostSettings& settings) {
  const PlanarPose pose{from.pose.x + d.x(), from.pose.y + d.y(), from.pose.yaw + d.z()};
  return cost.agreement(cells, pose, from.agreement.offset, settings).cost;
}

}  // namespace

Eigen::Matrix3d curvature(const DirectCost& cost, const AerialCells& cells, const Placement& best,
                          const CostSettings& settings, const Eigen::Vector3d& step) {
  const auto at = [&](const Eigen::Vector3d& d) {
    const double value = costAfter(cost, cells, best, d, settings);
    return std::isfinite(value) ? value : best.agreement.cost;
  };
  Eigen::Matrix3d H;
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    const Eigen::Vector3d di = step[i] * Eigen::Vector3d::Unit(i), dj = step[j] * Eigen::Vector3d::Unit(j);
    H(i, i) = (at(-di) - 2 * best.agreement.cost + at(di)) / (step[i] * step[i]);
    H(i, j) = H(j, i) = (at(-di - dj) - at(-di + dj) - at(di - dj) + at(di + dj)) / (4 * step[i] * step[j]);
  }
  return H;
}

Probe probe(const DirectCost& cost, const AerialCells& cells, const Placement& best, const CostSettings& settings,
            double distance, double noise_cost) {
  const double radius = std::max(cost.overlapAt(cells, best.pose).radius, 0.1);
  const Eigen::Vector3d scale(1, 1, 1 / radius);
  const Eigen::Matrix3d H =
      scale.asDiagonal() * curvature(cost, cells, best, settings, 0.5 * distance * scale) * scale.asDiagonal();
  std::vector<Eigen::Vector3d> directions{Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(H).eigenvectors().col(0),
                                          Eigen::Vector3d::UnitZ()};
  constexpr int kHalf = 8;
  for (int i = 0; i < kHalf; ++i) {
    directions.emplace_back(std::cos(i * M_PI / kHalf), std::sin(i * M_PI / kHalf), 0);
  }
  Probe weakest;
  for (const Eigen::Vector3d& direction : directions) {
    const Eigen::Vector3d d = scale.cwiseProduct(direction) * distance;
    for (int sign : {-1, 1}) {
      const double ratio =
          (costAfter(cost, cells, best, sign * d, settings) + noise_cost) / (best.agreement.cost + noise_cost);
      if (ratio >= weakest.ratio) continue;
      weakest = {ratio, d};
    }
  }
  return weakest;
}

}  // namespace heightmap_mcl
