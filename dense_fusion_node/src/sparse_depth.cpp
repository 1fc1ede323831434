#include "sparse_depth.h"

#include <algorithm>
#include <cmath>

#include "air_ground_common/statistics.h"

namespace dense_fusion {
namespace {

constexpr double kLargestRatio = 0.08;  // of what can be the same surface, as the next in logarithms
constexpr double kLargestSigma = 0.002;
constexpr std::size_t kLeastPoints = 30;

/// Of the points that lie about where the map has its surface.
std::vector<double> logRatios(const DepthMap& map, const std::vector<Eigen::Vector3f>& points) {
  const Eigen::Isometry3f T_camera_map = map.T_map_camera.inverse(Eigen::Isometry).cast<float>();
  const auto fx = static_cast<float>(map.camera.fx), fy = static_cast<float>(map.camera.fy);
  const auto cx = static_cast<float>(map.camera.cx), cy = static_cast<float>(map.camera.cy);
  std::vector<double> ratios;
  for (const Eigen::Vector3f& point : points) {
    const Eigen::Vector3f p = T_camera_map * point;
    if (!(p.z() > 0)) continue;
    const float u = fx * p.x() / p.z() + cx, v = fy * p.y() / p.z() + cy;
    if (!(u >= 0 && v >= 0 && u <= static_cast<float>(map.depth.cols - 1) &&
          v <= static_cast<float>(map.depth.rows - 1)))
      continue;
    const double ratio =
        std::log(p.z() / map.depth.at<float>(static_cast<int>(std::lround(v)), static_cast<int>(std::lround(u))));
    if (std::abs(ratio) < kLargestRatio) ratios.push_back(ratio);
  }
  return ratios;
}

}  // namespace

std::optional<double> sparseDepthRatio(const DepthMap& map, const std::vector<Eigen::Vector3f>& points) {
  const std::vector<double> ratios = logRatios(map, points);
  if (ratios.size() < kLeastPoints) return std::nullopt;
  double location = air_ground_common::median(ratios), sigma = 0;
  constexpr int kIterations = 5;
  for (int i = 0; i < kIterations; ++i) {
    std::vector<double> deviations;
    deviations.reserve(ratios.size());
    for (const double r : ratios) deviations.push_back(std::abs(r - location));
    const double spread = std::max(1e-4, 1.4826 * air_ground_common::median(std::move(deviations)));
    constexpr double kTukey = 4.685;
    double sum = 0, weights = 0;
    for (const double r : ratios) {
      const double e = (r - location) / (kTukey * spread), weight = std::abs(e) < 1 ? std::pow(1 - e * e, 2) : 0;
      sum += weight * r;
      weights += weight;
    }
    location = sum / weights;
    sigma = spread / std::sqrt(weights);
  }
  if (sigma > kLargestSigma) return std::nullopt;
  return std::exp(location);
}

}  // namespace dense_fusion
