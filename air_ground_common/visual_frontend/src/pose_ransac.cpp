#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <random>

#include "air_ground_common/statistics.h"
#include "visual_frontend/pose_solver.h"

namespace visual_frontend {

namespace {

/// Squared reprojection error in sigmas; huge behind the camera.
double squaredError(const PoseCorrespondence& c, const Pose& T_camera_map) {
  const Eigen::Vector3d p = T_camera_map * c.p_map;
  if (!(p.z() > 1e-3)) return 1e12;
  return squaredSigmas(p.head<2>() / p.z() - c.normalized, c.normalized, {c.sigma, c.elongation});
}

/// Standard deviation of the product of a line's normal with normalised coordinates.
double alongSigma(const Eigen::Vector2d& line, const Eigen::Vector2d& normalized, const NormalizedNoise& noise) {
  // The covariance is the whitening's of the inverse elongation, as its inverse is that of the elongation.
  return (whitening(normalized, {1 / noise.sigma, 1 / noise.elongation}) * line).norm();
}

int countInliers(const std::vector<PoseCorrespondence>& correspondences, const Pose& T_map_camera, double threshold2,
                 std::vector<unsigned char>* flags) {
  const Pose T_camera_map = T_map_camera.inverse();
  if (flags) flags->assign(correspondences.size(), 0);
  int count = 0;
  for (std::size_t i = 0; i < correspondences.size(); ++i) {
    if (!(squaredError(correspondences[i], T_camera_map) < threshold2)) continue;
    if (flags) (*flags)[i] = 1;
    ++count;
  }
  return count;
}

/// Rounds after which a clean sample was drawn with the wanted confidence.
int neededIterations(int inliers, std::size_t total, int sample, const RansacSettings& settings) {
  const double clean = std::pow(static_cast<double>(inliers) / total, sample);
  if (clean <= 1e-9) return settings.max_iterations;
  if (clean >= 1 - 1e-9) return 1;
  const double needed = std::log(1 - settings.confidence) / std::log(1 - clean);
  return needed > settings.max_iterations ? settings.max_iterations : static_cast<int>(std::ceil(needed));
}

class Sampler {
 public:
  Sampler(unsigned seed, std::size_t size) : generator_(seed), size_(size) {}
  template <std::size_t N>
  void draw(std::size_t (&index)[N]) {
    for (std::size_t i = 0; i < N; ++i) {
      bool repeated = true;
      while (repeated) {
        index[i] = generator_() % size_;
        repeated = std::find(index, index + i, index[i]) != index + i;
      }
    }
  }

 private:
  std::mt19937 generator_;
  std::size_t size_;
};

PoseResult failed(std::string reason, std::size_t size) {
  PoseResult result;
  result.reason = std::move(reason);
  result.inliers.assign(size, 0);
  return result;
}

void finish(const std::vector<PoseCorrespondence>& correspondences, const RansacSettings& settings,
            PoseResult& result) {
  const double threshold2 = settings.threshold * settings.threshold;
  result.inlier_count = countInliers(correspondences, result.T_map_camera, threshold2, &result.inliers);
  const Pose T_camera_map = result.T_map_camera.inverse();
  double sum = 0;
  for (std::size_t i = 0; i < correspondences.size(); ++i) {
    if (result.inliers[i]) sum += squaredError(correspondences[i], T_camera_map);
  }
  result.rms = result.inlier_count > 0 ? std::sqrt(sum / (2.0 * result.inlier_count)) : 0;
  result.success = result.inlier_count >= settings.min_inliers;
  if (!result.success) {
    result.reason =
        "only " + std::to_string(result.inlier_count) + " inliers of " + std::to_string(correspondences.size());
  }
}

}  // namespace

PoseResult ransacKnownRotation(const std::vector<PoseCorrespondence>& c, const Eigen::Matrix3d& R_map_camera,
                               const RansacSettings& settings) {
  if (c.size() < 2) return failed("fewer than 2 correspondences", c.size());
  const double threshold2 = settings.threshold * settings.threshold;
  Sampler sampler(settings.seed, c.size());
  PoseResult best;
  best.inlier_count = -1;
  Pose T = Pose::Identity();
  T.linear() = R_map_camera;
  int needed = settings.max_iterations;
  int iteration = 0;
  for (; iteration < needed; ++iteration) {
    std::size_t index[2];
    sampler.draw(index);
    const auto centre = solveP2P(R_map_camera, c[index[0]].p_map, c[index[0]].normalized.homogeneous(),
                                 c[index[1]].p_map, c[index[1]].normalized.homogeneous());
    if (!centre) continue;
    T.translation() = *centre;
    const int inliers = countInliers(c, T, threshold2, nullptr);
    if (inliers <= best.inlier_count) continue;
    best.inlier_count = inliers;
    best.T_map_camera = T;
    needed = neededIterations(inliers, c.size(), 2, settings);
  }
  if (best.inlier_count < 0) return failed("no sample gave a camera in front of its points", c.size());
  best.iterations = iteration;

  // All inliers at once: distances of points to rays, weighted to be reprojection errors.
  std::vector<unsigned char> flags;
  for (int round = 0; round < 2; ++round) {
    countInliers(c, best.T_map_camera, threshold2, &flags);
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < c.size(); ++i) {
      if (!flags[i]) continue;
      const Eigen::Vector3d d = (R_map_camera * c[i].normalized.homogeneous()).normalized();
      const double range = (c[i].p_map - best.T_map_camera.translation()).norm();
      const double weight = 1.0 / (range * range * c[i].sigma * c[i].sigma);
      const Eigen::Matrix3d P = weight * (Eigen::Matrix3d::Identity() - d * d.transpose());
      A += P;
      b += P * c[i].p_map;
    }
    T.translation() = A.ldlt().solve(b);
    if (!T.translation().allFinite() || countInliers(c, T, threshold2, nullptr) < best.inlier_count) break;
    best.T_map_camera = T;
    best.inlier_count = countInliers(c, T, threshold2, nullptr);
  }
  finish(c, settings, best);
  return best;
}

PoseResult ransacPose(const std::vector<PoseCorrespondence>& c, const RansacSettings& settings) {
  if (c.size() < 4) return failed("fewer than 4 correspondences", c.size());
  const double threshold2 = settings.threshold * settings.threshold;
  Sampler sampler(settings.seed, c.size());
  PoseResult best;
  best.inlier_count = -1;
  int needed = settings.max_iterations;
  int iteration = 0;
  for (; iteration < needed; ++iteration) {
    std::size_t index[4];
    sampler.draw(index);
    Eigen::Matrix3d points, rays;
    for (int i = 0; i < 3; ++i) {
      points.col(i) = c[index[i]].p_map;
      rays.col(i) = c[index[i]].normalized.homogeneous();
    }
    const Pose* chosen = nullptr;
    double chosen_error = 1e12;
    const std::vector<Pose> poses = solveP3P(points, rays);
    for (const Pose& T : poses) {
      const double error = squaredError(c[index[3]], T.inverse());
      if (error < chosen_error) {
        chosen_error = error;
        chosen = &T;
      }
    }
    if (!chosen) continue;
    const int inliers = countInliers(c, *chosen, threshold2, nullptr);
    if (inliers <= best.inlier_count) continue;
    best.inlier_count = inliers;
    best.T_map_camera = *chosen;
    needed = neededIterations(inliers, c.size(), 4, settings);
  }
  if (best.inlier_count < 0) return failed("no sample gave a pose", c.size());
  best.iterations = iteration;
  finish(c, settings, best);
  return best;
}

namespace {

/// Two lists of rays whose rotation is known: the epipolar constraint a . (t x R b) = 0, t normal to (R b) x a.
class EpipolarConstraints {
 public:
  EpipolarConstraints(const std::vector<Eigen::Vector2d>& a, const std::vector<Eigen::Vector2d>& b,
                      const Eigen::Matrix3d& R_a_b, double sigma, const std::vector<NormalizedNoise>& noise_a,
                      const std::vector<NormalizedNoise>& noise_b)
      : a_(a), b_(b), R_b_a_(R_a_b.transpose()), sigma_(sigma), noise_a_(noise_a), noise_b_(noise_b) {
    for (std::size_t i = 0; i < a.size(); ++i) {
      ray_a.push_back(a[i].homogeneous());
      ray_b.push_back(R_a_b * b[i].homogeneous());
      normal.push_back(ray_b[i].cross(ray_a[i]));
    }
  }

  /// In standard deviations of the constraint.
  double error(std::size_t i, const Eigen::Vector3d& t) const { return std::abs(normal[i].dot(t)) / deviation(i, t); }

  int inliers(const Eigen::Vector3d& t, double threshold) const {
    int count = 0;
    for (std::size_t i = 0; i < normal.size(); ++i) count += error(i, t) < threshold;
    return count;
  }

  /// Direction that fits the inliers of t best.
  Eigen::Vector3d fit(const Eigen::Vector3d& t, double threshold) const {
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < normal.size(); ++i) {
      if (!(error(i, t) < threshold)) continue;
      const double size = uniform() ? t.cross(ray_b[i]).squaredNorm() : std::pow(deviation(i, t) / sigma_, 2);
      A += normal[i] * normal[i].transpose() / std::max(size, 1e-9);
    }
    return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(A).eigenvectors().col(0);
  }

  std::vector<Eigen::Vector3d> ray_a, ray_b, normal;  ///< in a's frame

 private:
  bool uniform() const { return noise_a_.size() != a_.size() || noise_b_.size() != a_.size(); }

  /// First order (Sampson).
  double deviation(std::size_t i, const Eigen::Vector3d& t) const {
    const Eigen::Vector3d line_a = t.cross(ray_b[i]);
    const Eigen::Vector3d line_b = R_b_a_ * t.cross(ray_a[i]);
    if (!uniform())
      return std::max(std::hypot(alongSigma(line_a.head<2>(), a_[i], noise_a_[i]),
                                 alongSigma(line_b.head<2>(), b_[i], noise_b_[i])),
                      1e-9 * sigma_);
    const double denominator = std::sqrt(line_a.head<2>().squaredNorm() + line_b.head<2>().squaredNorm());
    return std::max(denominator, 1e-9) * sigma_;
  }

  const std::vector<Eigen::Vector2d>&a_, &b_;
  const Eigen::Matrix3d R_b_a_;
  const double sigma_;
  const std::vector<NormalizedNoise>&noise_a_, &noise_b_;
};

/// Signs and sizes of what the inliers of t show: positive votes when most lie in front of both cameras (depths in
/// d_a a = t + d_b R b), and their angles [rad].
int depthVotes(const EpipolarConstraints& constraints, const Eigen::Vector3d& t, double sigma, double threshold,
               std::vector<double>* parallax) {
  int votes = 0;
  for (std::size_t i = 0; i < constraints.normal.size(); ++i) {
    if (!(constraints.error(i, t) < threshold)) continue;
    const Eigen::Vector3d &a = constraints.ray_a[i], &b = constraints.ray_b[i];
    const double sine = a.normalized().cross(b.normalized()).norm();
    parallax->push_back(std::asin(std::min(1.0, sine)));
    if (sine < 2 * sigma) continue;  // too little to tell
    const Eigen::Vector3d n_ab = a.cross(b);
    const double depth_a = t.cross(b).dot(n_ab), depth_b = t.cross(a).dot(n_ab);
    votes += (depth_a > 0 && depth_b > 0) - (depth_a < 0 && depth_b < 0);
  }
  return votes;
}

}  // namespace

TranslationDirection translationFromKnownRotation(const std::vector<Eigen::Vector2d>& a,
                                                  const std::vector<Eigen::Vector2d>& b, const Eigen::Matrix3d& R_a_b,
                                                  double sigma, const RansacSettings& settings,
                                                  const std::vector<NormalizedNoise>& noise_a,
                                                  const std::vector<NormalizedNoise>& noise_b) {
  TranslationDirection result;
  const std::size_t n = a.size();
  result.inliers.assign(n, 0);
  if (n != b.size() || n < 2) {
    result.reason = "needs two lists of the same size, at least 2 points";
    return result;
  }
  const EpipolarConstraints constraints(a, b, R_a_b, sigma, noise_a, noise_b);
  Sampler sampler(settings.seed, n);
  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  int best_count = -1, needed = settings.max_iterations;
  for (int iteration = 0; iteration < needed; ++iteration) {
    std::size_t index[2];
    sampler.draw(index);
    Eigen::Vector3d t = constraints.normal[index[0]].cross(constraints.normal[index[1]]);
    // Without parallax the normals are noise.
    if (t.norm() < 1e-3 * sigma) continue;
    t.normalize();
    const int count = constraints.inliers(t, settings.threshold);
    if (count <= best_count) continue;
    best_count = count;
    best = t;
    needed = neededIterations(count, n, 2, settings);
  }
  if (best_count < 0) {
    result.reason = "no parallax";
    return result;
  }
  for (int round = 0; round < 3; ++round) {
    const Eigen::Vector3d t = constraints.fit(best, settings.threshold);
    const int count = constraints.inliers(t, settings.threshold);
    if (count < best_count) break;
    best = t;
    best_count = count;
  }
  std::vector<double> parallax;
  if (depthVotes(constraints, best, sigma, settings.threshold, &parallax) < 0) best = -best;
  result.t_a_b = best;
  for (std::size_t i = 0; i < n; ++i) result.inliers[i] = constraints.error(i, best) < settings.threshold;
  result.inlier_count = best_count;
  if (!parallax.empty()) result.median_parallax = air_ground_common::median(std::move(parallax));
  result.success = best_count >= settings.min_inliers;
  if (!result.success) result.reason = "only " + std::to_string(best_count) + " inliers of " + std::to_string(n);
  return result;
}

}  // namespace visual_frontend
