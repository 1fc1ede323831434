#include "heightmap_mcl/zmssd.h"

#include <cmath>
#include <stdexcept>

#include "zmssd_kernel.h"

namespace heightmap_mcl {

PlanarPose changeReference(const PlanarPose& pose, const Eigen::Vector2d& from, const Eigen::Vector2d& to) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  const Eigen::Vector2d d = to - from;
  return {pose.x + c * d.x() - s * d.y(), pose.y + s * d.x() + c * d.y(), pose.yaw};
}

void validate(const CostSettings& settings) {
  if (!(settings.min_overlap > 0 && settings.min_overlap <= 1)) {
    throw std::invalid_argument("cost settings: min_overlap must be in (0, 1]");
  }
  if (!(settings.unknown_cost >= 0 && std::isfinite(settings.unknown_cost))) {
    throw std::invalid_argument("cost settings: unknown_cost must not be negative [m^2]");
  }
  if (!(settings.min_explained >= 0 && settings.min_explained < 1 && settings.min_relief >= 0)) {
    throw std::invalid_argument("cost settings: min_explained must be in [0, 1), min_relief must not be negative [m]");
  }
}

Zmssd zmssdReference(const HeightMap& air, const HeightMap& ground, const Eigen::Vector2d& reference,
                     const PlanarPose& pose, const CostSettings& settings) {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  double aerial_cells = 0;
  std::vector<double> aerial, below;
  for (int row = 0; row < air.height; ++row) {
    for (int column = 0; column < air.width; ++column) {
      const double a = air.at(row, column);
      if (std::isnan(a)) continue;
      ++aerial_cells;
      const Eigen::Vector2d q = air.center(row, column) - reference;
      const double x = c * q.x() - s * q.y() + pose.x, y = s * q.x() + c * q.y() + pose.y;
      const double gc = std::floor((x - ground.origin_x) / ground.resolution);
      const double gr = std::floor((y - ground.origin_y) / ground.resolution);
      if (gc < 0 || gr < 0 || gc >= ground.width || gr >= ground.height) continue;
      const double g = ground.at(static_cast<int>(gr), static_cast<int>(gc));
      if (std::isnan(g)) continue;
      aerial.push_back(a);
      below.push_back(g);
    }
  }
  // The means first, then the squares about them: no cancellation.
  const auto mean = [](const std::vector<double>& values) {
    double sum = 0;
    for (double v : values) sum += v;
    return values.empty() ? 0.0 : sum / static_cast<double>(values.size());
  };
  const double mean_a = mean(aerial), mean_g = mean(below);
  OverlapSums sums;
  for (std::size_t i = 0; i < aerial.size(); ++i) {
    const double a = aerial[i] - mean_a, g = below[i] - mean_g;
    ++sums.n;
    sums.d2 += (a - g) * (a - g);
    sums.a2 += a * a;
    sums.g2 += g * g;
  }
  Zmssd result = zmssdFromSums(sums, std::min(aerial_cells, static_cast<double>(ground.defined())), settings);
  if (std::isfinite(result.cost)) result.dz = mean_g - mean_a;
  return result;
}

AerialCells aerialCells(const HeightMap& air, const Eigen::Vector2d& reference) {
  AerialCells cells;
  cells.reference = reference;
  const std::size_t n = air.defined();
  cells.x.reserve(n);
  cells.y.reserve(n);
  cells.h.reserve(n);
  double sum = 0;
  for (int row = 0; row < air.height; ++row) {
    for (int column = 0; column < air.width; ++column) {
      const float h = air.at(row, column);
      if (std::isnan(h)) continue;
      const Eigen::Vector2d q = air.center(row, column) - reference;
      cells.x.push_back(static_cast<float>(q.x()));
      cells.y.push_back(static_cast<float>(q.y()));
      cells.h.push_back(h);
      sum += h;
    }
  }
  if (n > 0) cells.mean_height = sum / static_cast<double>(n);
  for (float& h : cells.h) h -= static_cast<float>(cells.mean_height);
  return cells;
}

DirectCost::DirectCost(const HeightMap& ground)
    : resolution_(ground.resolution),
      origin_x_(ground.origin_x - ground.resolution),
      origin_y_(ground.origin_y - ground.resolution),
      mean_(0),
      width_(ground.width + 2),
      height_(ground.height + 2),
      heights_(static_cast<std::size_t>(width_) * height_, kHole) {
  for (float h : ground.heights) {
    if (std::isnan(h)) continue;
    mean_ += h;
    ++defined_;
  }
  if (defined_ == 0) throw std::invalid_argument("DirectCost: the ground height map has no defined cell");
  mean_ /= defined_;
  for (int r = 0; r < ground.height; ++r) {
    for (int c = 0; c < ground.width; ++c) {
      heights_[static_cast<std::size_t>(r + 1) * width_ + c + 1] = ground.at(r, c) - static_cast<float>(mean_);
    }
  }
}

Zmssd DirectCost::operator()(const AerialCells& cells, const PlanarPose& pose, const CostSettings& settings) const {
  const double inverse = 1 / resolution_;
  const auto sums = kernel::overlapSums(
      cells.x.data(), cells.y.data(), cells.h.data(), static_cast<int>(cells.h.size()),
      static_cast<float>(std::cos(pose.yaw) * inverse), static_cast<float>(std::sin(pose.yaw) * inverse),
      static_cast<float>((pose.x - origin_x_) * inverse), static_cast<float>((pose.y - origin_y_) * inverse),
      {heights_.data(), width_, height_});
  const double smaller = std::min(static_cast<double>(cells.h.size()), defined_);
  Zmssd result = zmssdFromSums(sums, smaller, settings);
  if (std::isfinite(result.cost)) result.dz += mean_ - cells.mean_height;
  return result;
}

std::vector<Zmssd> DirectCost::operator()(const AerialCells& cells, const std::vector<PlanarPose>& poses,
                                          const CostSettings& settings) const {
  std::vector<Zmssd> results(poses.size());
  const int n = static_cast<int>(poses.size());
  // Below some dozens of poses, waking the threads costs more than they save, the more so on a busy machine.
#pragma omp parallel for schedule(static) if (n > 60)
  for (int i = 0; i < n; ++i) results[i] = (*this)(cells, poses[i], settings);
  return results;
}

float DirectCost::groundAt(double x, double y) const {
  const double c = std::floor((x - origin_x_) / resolution_), r = std::floor((y - origin_y_) / resolution_);
  if (c < 0 || r < 0 || c >= width_ || r >= height_) return kHole;
  return heights_[static_cast<std::size_t>(r) * width_ + static_cast<std::size_t>(c)];
}

Eigen::Vector2d DirectCost::overlapCenter(const AerialCells& cells, const PlanarPose& pose) const {
  const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double n = 0;
  for (std::size_t i = 0; i < cells.h.size(); ++i) {
    const Eigen::Vector2d p(c * cells.x[i] - s * cells.y[i] + pose.x, s * cells.x[i] + c * cells.y[i] + pose.y);
    if (std::isnan(groundAt(p.x(), p.y()))) continue;
    sum += p;
    ++n;
  }
  return n > 0 ? Eigen::Vector2d(sum / n) : Eigen::Vector2d(pose.x, pose.y);
}

}  // namespace heightmap_mcl
