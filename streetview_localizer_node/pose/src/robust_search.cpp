#include "robust_search.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "planar_alternative.h"

namespace streetview_localizer::detail {

using visual_frontend::P3PSolutions;
using visual_frontend::PoseCorrespondence;

namespace {

constexpr double kMinDepth = 0.05;        // [m]
constexpr double kPlaneTolerance = 0.05;  // [m]

/// Draws three matches, the best ones first: after `t` samples from the best n, where n grows as in PROSAC (Chum and
/// Matas, CVPR 2005, eq. 3-5) so that after kGrowth samples all take part.
class ProgressiveSampler {
 public:
  ProgressiveSampler(const std::vector<double>& quality, unsigned seed) : generator_(seed), order_(quality.size()) {
    std::iota(order_.begin(), order_.end(), 0);
    std::shuffle(order_.begin(), order_.end(), generator_);
    std::stable_sort(order_.begin(), order_.end(), [&](int a, int b) { return quality[a] > quality[b]; });
    pool_ = std::min<std::size_t>(order_.size(), kFirst);
    const double N = static_cast<double>(order_.size()), n = static_cast<double>(pool_);
    expected_ = kGrowth * n * (n - 1) * (n - 2) / (N * (N - 1) * (N - 2));
  }
  void draw(int (&index)[3]) {
    ++drawn_;
    while (drawn_ > end_ && pool_ < order_.size()) {
      const double next = expected_ * static_cast<double>(pool_ + 1) / static_cast<double>(pool_ - 2);
      end_ += std::ceil(next - expected_);
      expected_ = next;
      ++pool_;
    }
    for (int i = 0; i < 3; ++i) {
      bool repeated = true;
      while (repeated) {
        index[i] = order_[generator_() % pool_];
        repeated = std::find(index, index + i, index[i]) != index + i;
      }
    }
  }

 private:
  static constexpr double kGrowth = 500;
  static constexpr std::size_t kFirst = 6;
  std::mt19937 generator_;
  std::vector<int> order_;
  std::size_t pool_;
  double expected_, drawn_ = 0, end_ = 1;
};

bool plausible(const Matches& matches, const int (&sample)[3], const Pose& T, const PosePrior& prior) {
  const Eigen::Vector3d& centre = T.translation();
  if (centre.z() < prior.min_z - 1 || centre.z() > prior.max_z + 1) return false;
  if (tilt(prior, T) > mostTilt(prior)) return false;
  for (const int i : sample) {
    if (matches.normals[i].dot(centre - matches.points[i].p_map) < 0) return false;
  }
  return true;
}

}  // namespace

Matches prepare(const std::vector<Correspondence>& correspondences, const CameraModel& camera) {
  Matches m;
  for (std::size_t i = 0; i < correspondences.size(); ++i) {
    const Correspondence& c = correspondences[i];
    if (!c.pixel.allFinite() || !c.p_world.allFinite() || !std::isfinite(c.quality)) continue;
    PoseCorrespondence p;
    p.p_map = c.p_world;
    p.normalized = camera.unproject(c.pixel);
    // How far a pixel reaches in normalised coordinates here: the lens stretches towards the corners.
    constexpr double kStep = 1e-4;
    const Eigen::Vector2d dx = camera.distort(p.normalized + Eigen::Vector2d(kStep, 0)) -
                               camera.distort(p.normalized - Eigen::Vector2d(kStep, 0));
    const Eigen::Vector2d dy = camera.distort(p.normalized + Eigen::Vector2d(0, kStep)) -
                               camera.distort(p.normalized - Eigen::Vector2d(0, kStep));
    const double stretch = std::sqrt(std::abs(dx.x() * dy.y() - dx.y() * dy.x())) / (2 * kStep);
    p.sigma = 1 / (std::sqrt(camera.fx * camera.fy) * stretch);
    if (!p.normalized.allFinite() || !std::isfinite(p.sigma)) continue;
    m.points.push_back(p);
    m.index.push_back(static_cast<int>(i));
    m.normals.push_back(c.normal.allFinite() ? c.normal : Eigen::Vector3d::Zero());
    m.centres.push_back(c.view_centre);
    m.quality.push_back(c.quality);
  }
  for (const auto& p : m.points) m.origin += p.p_map / static_cast<double>(m.size());
  for (const auto& p : m.points) {
    const Eigen::Vector3d q = p.p_map - m.origin;
    m.x.push_back(static_cast<float>(q.x()));
    m.y.push_back(static_cast<float>(q.y()));
    m.z.push_back(static_cast<float>(q.z()));
    m.u.push_back(static_cast<float>(p.normalized.x()));
    m.v.push_back(static_cast<float>(p.normalized.y()));
    m.weight.push_back(static_cast<float>(1 / p.sigma));
  }
  m.wall.assign(m.size(), -1);
  std::vector<int> all(m.size());
  std::iota(all.begin(), all.end(), 0);
  const auto planes = wallsOf(m, all, kPlaneTolerance);
  for (std::size_t w = 0; w < planes.size(); ++w)
    for (const int i : planes[w]) m.wall[i] = static_cast<int>(w);
  return m;
}

Matches subset(const Matches& m, const std::vector<int>& positions) {
  Matches s;
  s.origin = m.origin;
  for (const int i : positions) {
    s.points.push_back(m.points[i]);
    s.index.push_back(m.index[i]);
    s.normals.push_back(m.normals[i]);
    s.centres.push_back(m.centres[i]);
    s.wall.push_back(m.wall[i]);
    s.quality.push_back(m.quality[i]);
    s.x.push_back(m.x[i]);
    s.y.push_back(m.y[i]);
    s.z.push_back(m.z[i]);
    s.u.push_back(m.u[i]);
    s.v.push_back(m.v[i]);
    s.weight.push_back(m.weight[i]);
  }
  return s;
}

double truncatedCost(const Matches& m, const Pose& T_world_camera, double threshold, double limit) {
  const Eigen::Matrix3f R = T_world_camera.linear().transpose().cast<float>();
  const Eigen::Vector3f t =
      (T_world_camera.linear().transpose() * (m.origin - T_world_camera.translation())).cast<float>();
  const float bound = static_cast<float>(threshold * threshold);
  const std::size_t n = m.size();
  constexpr std::size_t kBlock = 32;
  double cost = 0;
  for (std::size_t begin = 0; begin < n && cost < limit; begin += kBlock) {
    const std::size_t end = std::min(n, begin + kBlock);
    float sum = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const float px = R(0, 0) * m.x[i] + R(0, 1) * m.y[i] + R(0, 2) * m.z[i] + t.x();
      const float py = R(1, 0) * m.x[i] + R(1, 1) * m.y[i] + R(1, 2) * m.z[i] + t.y();
      const float pz = R(2, 0) * m.x[i] + R(2, 1) * m.y[i] + R(2, 2) * m.z[i] + t.z();
      const float inverse = 1 / std::max(pz, static_cast<float>(kMinDepth));
      const float du = (px * inverse - m.u[i]) * m.weight[i], dv = (py * inverse - m.v[i]) * m.weight[i];
      sum += pz > static_cast<float>(kMinDepth) ? std::min(bound, du * du + dv * dv) : bound;
    }
    cost += sum;
  }
  return cost;
}

double squaredError(const Matches& m, std::size_t i, const Pose& T_camera_world) {
  const Eigen::Vector3d p = T_camera_world * m.points[i].p_map;
  if (!(p.z() > kMinDepth)) return 1e12;
  return (p.head<2>() / p.z() - m.points[i].normalized).squaredNorm() / (m.points[i].sigma * m.points[i].sigma);
}

std::vector<int> inliersOf(const Matches& m, const Pose& T_world_camera, double threshold) {
  const Pose T_camera_world = T_world_camera.inverse();
  std::vector<int> inliers;
  for (std::size_t i = 0; i < m.size(); ++i) {
    if (squaredError(m, i, T_camera_world) < threshold * threshold) inliers.push_back(static_cast<int>(i));
  }
  return inliers;
}

double facingShare(const Matches& m, const std::vector<int>& positions, const Eigen::Vector3d& centre) {
  int known = 0, facing = 0;
  for (const int i : positions) {
    if (m.normals[i].squaredNorm() < 0.25) continue;
    ++known;
    facing += m.normals[i].dot(centre - m.points[i].p_map) > 0;
  }
  return known > 0 ? static_cast<double>(facing) / known : 1.0;
}

double tilt(const PosePrior& prior, const Pose& T_world_camera) {
  if (!prior.up_camera) return 0;
  const Eigen::Vector3d up = T_world_camera.linear() * prior.up_camera->normalized();
  return std::atan2(up.head<2>().norm(), up.z());
}

double mostTilt(const PosePrior& prior) { return 0.35 + 3 * prior.up_stddev; }

std::optional<Pose> refine(const Matches& m, const std::vector<int>& positions, const Pose& initial, double noise,
                           const PosePrior& prior, int iterations) {
  std::vector<PoseCorrespondence> points;
  points.reserve(positions.size());
  for (const int i : positions) {
    points.push_back(m.points[i]);
    points.back().sigma *= noise;
  }
  visual_frontend::RefineSettings settings;
  settings.max_iterations = iterations;
  settings.inlier_threshold = 1e6;  // the caller has chosen them
  settings.up_camera = prior.up_camera;
  settings.up_sigma = prior.up_stddev;
  const visual_frontend::PoseResult result = visual_frontend::refinePose(points, initial, settings);
  if (!result.success || !result.T_map_camera.matrix().allFinite()) return std::nullopt;
  return result.T_map_camera;
}

std::optional<Pose> converge(const Matches& m, std::vector<int> positions, const Pose& initial, double noise,
                             const PosePrior& prior, const PoseSettings& settings, int rounds) {
  Pose T = initial;
  for (int round = 0; round < rounds; ++round) {
    if (static_cast<int>(positions.size()) < std::max(4, settings.min_inliers / 2)) return std::nullopt;
    const auto refined = refine(m, positions, T, noise, prior);
    if (!refined) return std::nullopt;
    T = *refined;
    std::vector<int> next = inliersOf(m, T, settings.inlier_threshold);
    if (next == positions) break;
    positions = std::move(next);
  }
  return T;
}

std::optional<Pose> search(const Matches& m, const PosePrior& prior, const PoseSettings& settings, int max_iterations) {
  if (m.size() < 4) return std::nullopt;
  ProgressiveSampler sampler(m.quality, settings.seed);
  std::optional<Pose> best;
  double best_cost = std::numeric_limits<double>::infinity();
  int needed = max_iterations;
  for (int iteration = 0; iteration < needed; ++iteration) {
    int sample[3];
    sampler.draw(sample);
    Eigen::Matrix3d points, rays;
    for (int i = 0; i < 3; ++i) {
      points.col(i) = m.points[sample[i]].p_map;
      rays.col(i) = m.points[sample[i]].normalized.homogeneous();
    }
    const P3PSolutions solutions = visual_frontend::solveP3PFixed(points, rays);
    bool improved = false;
    for (int s = 0; s < solutions.size; ++s) {
      Pose T = Pose::Identity();
      T.linear() = solutions.R_map_camera[s];
      T.translation() = solutions.t_map_camera[s];
      if (!plausible(m, sample, T, prior)) continue;
      const double cost = truncatedCost(m, T, settings.inlier_threshold, best_cost);
      if (cost >= best_cost) continue;
      best_cost = cost;
      best = T;
      improved = true;
    }
    if (!improved) continue;
    // Local optimisation (Chum, Matas, Kittler 2003): with the wider set first, since three noisy points fix little.
    const std::vector<int> wide = inliersOf(m, *best, 2 * settings.inlier_threshold);
    if (static_cast<int>(wide.size()) < std::max(5, settings.min_inliers / 2)) continue;
    if (const auto local = converge(m, wide, *best, settings.inlier_threshold / 3, prior, settings, 2)) {
      const double cost = truncatedCost(m, *local, settings.inlier_threshold, best_cost);
      if (cost < best_cost) {
        best_cost = cost;
        best = local;
      }
    }
    const double share =
        static_cast<double>(inliersOf(m, *best, settings.inlier_threshold).size()) / static_cast<double>(m.size());
    const double clean = std::pow(share, 3);
    if (clean > 1 - 1e-9) {
      needed = std::min(needed, iteration + 1);
    } else if (clean > 1e-9) {
      needed = static_cast<int>(
          std::min<double>(max_iterations, std::ceil(std::log(1 - settings.confidence) / std::log(1 - clean))));
    }
  }
  return best;
}

}  // namespace streetview_localizer::detail
