#include "heightmap_mcl/particle_filter.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "air_ground_common/geometry.h"

namespace heightmap_mcl {

using air_ground_common::wrapAngle;

void validate(const FilterSettings& s) {
  const auto require = [](bool ok, const std::string& text) {
    if (!ok) throw std::invalid_argument("filter settings: " + text);
  };
  require(s.particles >= 10, "particles must be at least 10");
  require(s.sampling_sigma > 0, "sampling_sigma must be positive [m^2]");
  require(s.weight_sigma > 0, "weight_sigma must be positive [m^2]");
  require(s.position_noise >= 0 && s.position_noise_per_metre >= 0, "position noise must not be negative [m]");
  require(s.yaw_noise >= 0 && s.yaw_noise_per_metre >= 0, "yaw noise must not be negative [rad]");
  require(s.mixture_ratio >= 0 && s.mixture_ratio < 1, "mixture_ratio must be in [0, 1)");
}

ParticleFilter::ParticleFilter(const FilterSettings& settings, std::uint64_t seed)
    : settings_(settings), random_(seed) {
  validate(settings_);
}

namespace {

/// Where a prior forbids the lowest cost, the exponents are relative to the likeliest place.
double lowestWithPrior(const CostVolume& volume, const Prior& prior, double sampling_sigma) {
  double lowest = kInfinity;
  for (const CostMap& map : volume.slices) {
    for (int r = 0; r < map.height; ++r) {
      for (int c = 0; c < map.width; ++c) {
        if (!std::isfinite(map.at(r, c))) continue;
        const double log_density = prior.logDensity(map.pose(r, c), volume.pivot);
        lowest = std::min(lowest, map.at(r, c) - sampling_sigma * log_density);
      }
    }
  }
  return lowest;
}

}  // namespace

std::vector<PlanarPose> ParticleFilter::draw(const CostVolume& volume, const Prior& prior, int count) {
  if (count <= 0) return {};
  const int n = static_cast<int>(volume.slices.size());
  const bool use_prior = prior.any();
  const double lowest = use_prior ? lowestWithPrior(volume, prior, samplingSigma()) : volume.lowest();
  if (!std::isfinite(lowest)) return {};
  const auto weightOf = [&](const CostMap& map, int row, int column) -> double {
    const float cost = map.at(row, column);
    if (!std::isfinite(cost)) return 0;
    double exponent = -(cost - lowest) / samplingSigma();
    if (use_prior) exponent += prior.logDensity(map.pose(row, column), volume.pivot);
    return exponent > -50 ? std::exp(exponent) : 0;
  };
  // One cumulative sum over rows, then only the rows that are hit are walked.
  std::vector<std::size_t> first_row(n + 1, 0);
  for (int k = 0; k < n; ++k) first_row[k + 1] = first_row[k] + volume.slices[k].height;
  std::vector<double> row_sum(first_row[n], 0);
#pragma omp parallel for schedule(dynamic)
  for (int k = 0; k < n; ++k) {
    const CostMap& map = volume.slices[k];
    for (int r = 0; r < map.height; ++r) {
      double sum = 0;
      for (int c = 0; c < map.width; ++c) sum += weightOf(map, r, c);
      row_sum[first_row[k] + r] = sum;
    }
  }
  double total = 0;
  for (double s : row_sum) total += s;
  if (!(total > 0)) return {};

  std::uniform_real_distribution<double> uniform(0, 1), centred(-0.5, 0.5);
  const double yaw_step = n > 1 ? std::abs(wrapAngle(volume.slices[1].yaw - volume.slices[0].yaw)) : 0;
  std::vector<PlanarPose> poses;
  const double stride = total / count;
  double target = uniform(random_) * stride, passed = 0;
  for (int k = 0; k < n; ++k) {
    const CostMap& map = volume.slices[k];
    for (int r = 0; r < map.height; ++r) {
      const double sum = row_sum[first_row[k] + r];
      if (passed + sum < target) {
        passed += sum;
        continue;
      }
      double in_row = passed;
      for (int c = 0; c < map.width && static_cast<int>(poses.size()) < count; ++c) {
        in_row += weightOf(map, r, c);
        while (in_row >= target && static_cast<int>(poses.size()) < count) {
          PlanarPose pose = map.pose(r, c);
          pose.x += centred(random_) * map.resolution;
          pose.y += centred(random_) * map.resolution;
          pose.yaw = wrapAngle(pose.yaw + centred(random_) * yaw_step);
          poses.push_back(pose);
          target += stride;
        }
      }
      passed += sum;
    }
  }
  return poses;
}

bool ParticleFilter::initialize(const CostVolume& volume, const Prior& prior, const Eigen::Vector2d& reference) {
  particles_.clear();
  reference_ = reference;
  const auto poses = draw(volume, prior, settings_.particles);
  for (const PlanarPose& pose : poses) {
    particles_.push_back({changeReference(pose, volume.pivot, reference), 1.0 / static_cast<double>(poses.size())});
  }
  return !particles_.empty();
}

void ParticleFilter::move(const Eigen::Vector2d& reference) {
  const double distance = (reference - reference_).norm();
  const double sigma_xy = std::hypot(settings_.position_noise, settings_.position_noise_per_metre * distance);
  const double sigma_yaw = std::hypot(settings_.yaw_noise, settings_.yaw_noise_per_metre * distance);
  std::normal_distribution<double> normal(0, 1);
  for (Particle& p : particles_) {
    p.pose = changeReference(p.pose, reference_, reference);
    p.pose.x += sigma_xy * normal(random_);
    p.pose.y += sigma_xy * normal(random_);
    p.pose.yaw = wrapAngle(p.pose.yaw + sigma_yaw * normal(random_));
  }
  reference_ = reference;
}

bool ParticleFilter::weigh(const DirectCost& cost, const AerialCells& cells, const CostSettings& settings) {
  if ((cells.reference - reference_).norm() > 1e-6) {
    throw std::invalid_argument("ParticleFilter::weigh: the cells' reference point is not the filter's");
  }
  std::vector<PlanarPose> poses;
  poses.reserve(particles_.size());
  for (const Particle& p : particles_) poses.push_back(p.pose);
  const auto values = cost(cells, poses, settings);
  double lowest = kInfinity;
  for (const Zmssd& v : values) lowest = std::min(lowest, v.score);
  if (!std::isfinite(lowest)) return false;
  const double sigma = sigma_share_ * settings_.weight_sigma;
  std::vector<double> weights(particles_.size());
  double total = 0;
  for (std::size_t i = 0; i < particles_.size(); ++i) {
    weights[i] = particles_[i].weight * std::exp(-(values[i].score - lowest) / sigma);
    total += weights[i];
  }
  if (!(total > 0)) return false;
  for (std::size_t i = 0; i < particles_.size(); ++i) particles_[i].weight = weights[i] / total;
  return true;
}

void ParticleFilter::resample(const CostVolume* volume, const Prior& prior) {
  if (particles_.empty()) return;
  std::vector<PlanarPose> fresh;
  if (volume != nullptr && settings_.mixture_ratio > 0) {
    fresh = draw(*volume, prior, static_cast<int>(std::lround(settings_.mixture_ratio * settings_.particles)));
  }
  const std::size_t kept = static_cast<std::size_t>(settings_.particles) - fresh.size();
  std::vector<Particle> result;
  result.reserve(settings_.particles);
  const double stride = 1.0 / static_cast<double>(kept), weight = 1.0 / settings_.particles;
  double target = std::uniform_real_distribution<double>(0, stride)(random_), sum = 0;
  for (const Particle& p : particles_) {
    sum += p.weight;
    while (sum >= target && result.size() < kept) {
      result.push_back({p.pose, weight});
      target += stride;
    }
  }
  // Rounding may leave the last one out.
  while (result.size() < kept) result.push_back({particles_.back().pose, weight});
  for (const PlanarPose& pose : fresh) result.push_back({changeReference(pose, volume->pivot, reference_), weight});
  particles_ = std::move(result);
}

std::vector<ParticleMode> ParticleFilter::modes(double distance, double angle) const {
  const std::size_t n = particles_.size();
  const auto near = [&](const PlanarPose& a, const PlanarPose& b) {
    return std::hypot(a.x - b.x, a.y - b.y) <= distance && std::abs(wrapAngle(a.yaw - b.yaw)) <= angle;
  };
  std::vector<char> taken(n, 0);
  std::vector<ParticleMode> modes;
  for (double left = 1; left > 0.02 && modes.size() < 20;) {
    double best_density = 0;
    PlanarPose center;
    for (std::size_t i = 0; i < n; ++i) {
      if (taken[i]) continue;
      double density = 0;
      for (std::size_t j = 0; j < n; ++j) {
        if (!taken[j] && near(particles_[i].pose, particles_[j].pose)) density += particles_[j].weight;
      }
      if (density > best_density) {
        best_density = density;
        center = particles_[i].pose;
      }
    }
    if (best_density <= 0) break;
    ParticleMode mode;
    // Mean shift: the densest particle need not be the middle of its cluster.
    for (int iteration = 0; iteration < 3; ++iteration) {
      double weight = 0, x = 0, y = 0, yaw = 0;
      for (std::size_t j = 0; j < n; ++j) {
        const Particle& p = particles_[j];
        if (taken[j] || !near(center, p.pose)) continue;
        weight += p.weight;
        x += p.weight * p.pose.x;
        y += p.weight * p.pose.y;
        yaw += p.weight * wrapAngle(p.pose.yaw - center.yaw);
      }
      if (!(weight > 0)) break;
      center = {x / weight, y / weight, wrapAngle(center.yaw + yaw / weight)};
      mode.weight = weight;
    }
    if (!(mode.weight > 0)) break;
    mode.mean = center;
    for (std::size_t j = 0; j < n; ++j) {
      const Particle& p = particles_[j];
      if (taken[j] || !near(center, p.pose)) continue;
      taken[j] = 1;
      const Eigen::Vector3d d(p.pose.x - center.x, p.pose.y - center.y, wrapAngle(p.pose.yaw - center.yaw));
      mode.covariance += p.weight / mode.weight * d * d.transpose();
    }
    left -= mode.weight;
    modes.push_back(mode);
  }
  std::stable_sort(modes.begin(), modes.end(),
                   [](const ParticleMode& a, const ParticleMode& b) { return a.weight > b.weight; });
  return modes;
}

PlanarPose ParticleFilter::mean() const {
  double x = 0, y = 0, c = 0, s = 0;
  for (const Particle& p : particles_) {
    x += p.weight * p.pose.x;
    y += p.weight * p.pose.y;
    c += p.weight * std::cos(p.pose.yaw);
    s += p.weight * std::sin(p.pose.yaw);
  }
  return {x, y, std::atan2(s, c)};
}

ParticleFilter::Spread ParticleFilter::spread() const {
  double x = 0, y = 0, c = 0, s = 0, squares = 0;
  for (const Particle& p : particles_) {
    x += p.weight * p.pose.x;
    y += p.weight * p.pose.y;
    c += p.weight * std::cos(p.pose.yaw);
    s += p.weight * std::sin(p.pose.yaw);
  }
  for (const Particle& p : particles_) {
    squares += p.weight * ((p.pose.x - x) * (p.pose.x - x) + (p.pose.y - y) * (p.pose.y - y));
  }
  const double length = std::clamp(std::hypot(c, s), 1e-12, 1.0);
  return {std::sqrt(squares / 2), std::sqrt(-2 * std::log(length))};
}

}  // namespace heightmap_mcl
