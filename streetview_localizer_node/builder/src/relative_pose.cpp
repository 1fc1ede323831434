#include "relative_pose.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "air_ground_common/covariance.h"
#include "air_ground_common/linear_algebra.h"
#include "visual_frontend/pose_solver.h"

namespace streetview_localizer {
namespace {

using air_ground_common::Matrix6d;
using air_ground_common::Pose;

/// A point on a facade as one image puts it there, and where the other sees it.
struct Sight {
  Eigen::Vector3d p_world, bearing;  ///< bearing: in the other's body frame
  Eigen::Vector3d shift;             ///< of the point, for each metre that the wall stands out farther
  int wall = 0;
};

struct Wall {
  int building;
  Eigen::Vector3d normal;
};

/// The facade's number; a new one if need be.
int wallOf(int building, const Eigen::Vector3d& normal, std::vector<Wall>* walls) {
  constexpr double kSameWall = 0.95;
  for (std::size_t i = 0; i < walls->size(); ++i)
    if ((*walls)[i].building == building && (*walls)[i].normal.dot(normal) > kSameWall) return static_cast<int>(i);
  walls->push_back({building, normal});
  return static_cast<int>(walls->size()) - 1;
}

class Solver {
 public:
  explicit Solver(const RelativePoseSettings& settings) : s_(settings) {}

  void cast(const BearingFeatures& a, const Pose& T_world_a, const BearingFeatures& b,
            const std::vector<Match>& matches, const BackProjector& projector) {
    std::vector<Wall> walls;
    for (const Match& match : matches) {
      const Eigen::Vector3d direction = T_world_a.linear() * a.bearings[match.query];
      const auto hit = projector.cast(T_world_a.translation(), direction);
      if (!hit || hit->distance > s_.max_distance || !projector.model().isBuilding(hit->triangle)) continue;
      const double slope = hit->normal.dot(direction);
      if (-slope < std::cos(s_.max_incidence)) continue;
      const int wall = wallOf(projector.model().building[hit->triangle], hit->normal, &walls);
      sights_.push_back({hit->point, b.bearings[match.view], direction / slope, wall});
    }
    walls_ = static_cast<int>(walls.size());
  }

  std::optional<RelativePose> solve(const Pose& T_world_a) {
    std::vector<int> all(sights_.size());
    std::iota(all.begin(), all.end(), 0);
    std::vector<int> inliers;
    const auto start = search(all, s_.max_iterations, &inliers);
    if (!start) return std::nullopt;
    Pose T_world_b = *start;
    Matrix6d covariance;
    if (!refine(&T_world_b, &inliers, &covariance) || !spread(inliers)) return std::nullopt;
    std::vector<int> rest, others;
    std::set_difference(all.begin(), all.end(), inliers.begin(), inliers.end(), std::back_inserter(rest));
    search(rest, s_.max_iterations / 4, &others);
    if (static_cast<double>(others.size()) > s_.max_rival * static_cast<double>(inliers.size())) return std::nullopt;
    RelativePose result;
    result.T_a_b = T_world_a.inverse() * T_world_b;
    result.covariance = air_ground_common::aboutAxes(T_world_a.linear().transpose(), covariance);
    result.inliers = static_cast<int>(inliers.size());
    return result;
  }

 private:
  /// Where the sight's point lies off its bearing [rad]; two where it lies behind.
  double errorOf(const Sight& sight, const Pose& T_b_world) const {
    const Eigen::Vector3d d = T_b_world * sight.p_world;
    return d.dot(sight.bearing) > 0 ? d.cross(sight.bearing).norm() / d.norm() : 2.0;
  }

  std::vector<int> agreeing(const std::vector<int>& among, const Pose& T_world_b, double limit) const {
    const Pose T_b_world = T_world_b.inverse();
    std::vector<int> found;
    for (const int i : among)
      if (errorOf(sights_[i], T_b_world) < limit) found.push_back(i);
    return found;
  }

  /// The pose that most of the sights agree with. Walls are not moved yet: they are allowed twice the error.
  std::optional<Pose> search(const std::vector<int>& among, int iterations, std::vector<int>* inliers) const {
    const double limit = 2 * s_.max_error;
    const auto n = static_cast<unsigned>(among.size());
    inliers->clear();
    if (n < 4) return std::nullopt;
    std::optional<Pose> best;
    std::mt19937 random(1);
    double needed = iterations;
    for (int iteration = 0; iteration < needed; ++iteration) {
      const int sample[3] = {among[random() % n], among[random() % n], among[random() % n]};
      if (sample[0] == sample[1] || sample[0] == sample[2] || sample[1] == sample[2]) continue;
      Eigen::Matrix3d points, rays;
      for (int k = 0; k < 3; ++k) points.col(k) = sights_[sample[k]].p_world, rays.col(k) = sights_[sample[k]].bearing;
      const visual_frontend::P3PSolutions solutions = visual_frontend::solveP3PFixed(points, rays);
      for (int k = 0; k < solutions.size; ++k) {
        Pose T = Pose::Identity();
        T.linear() = solutions.R_map_camera[k];
        T.translation() = solutions.t_map_camera[k];
        if (T.linear()(2, 2) < kLeastUpright) continue;
        std::vector<int> found = agreeing(among, T, limit);
        if (found.size() <= inliers->size()) continue;
        *inliers = std::move(found);
        best = T;
        const double share = static_cast<double>(inliers->size()) / n;
        needed = std::min(needed, std::log(1e-4) / std::log1p(-std::min(0.999, share * share * share)));
      }
    }
    return best;
  }

  /// Gauss-Newton on the pose and an offset of each wall; which sights agree is counted again each time.
  bool refine(Pose* T_world_b, std::vector<int>* inliers, Matrix6d* covariance) const {
    std::vector<double> offset(walls_, 0.0);
    constexpr int kIterations = 10;
    for (int iteration = 0; iteration <= kIterations; ++iteration) {
      if (static_cast<int>(inliers->size()) < s_.min_inliers) return false;
      const int n = 6 + walls_;
      Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
      Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
      for (int w = 0; w < walls_; ++w) {
        const double weight = 1 / (s_.wall_stddev * s_.wall_stddev);
        H(6 + w, 6 + w) += weight;
        g(6 + w) += weight * offset[w];
      }
      double chi2 = 0;
      for (const int i : *inliers) chi2 += add(sights_[i], *T_world_b, offset[sights_[i].wall], &H, &g);
      const Eigen::LDLT<Eigen::MatrixXd> solver(H);
      if (iteration == kIterations) {
        const double noise = std::max(1.0, chi2 / (2 * static_cast<double>(inliers->size()) - 6));
        *covariance = noise * solver.solve(Eigen::MatrixXd::Identity(n, 6)).topRows<6>();
        return covariance->allFinite();
      }
      const Eigen::VectorXd step = -solver.solve(g);
      if (!step.allFinite()) return false;
      T_world_b->translation() += step.head<3>();
      T_world_b->linear() = air_ground_common::expSO3(step.segment<3>(3)) * T_world_b->linear();
      for (int w = 0; w < walls_; ++w) offset[w] += step(6 + w);
      inliers->clear();
      const Pose T_b_world = T_world_b->inverse();
      const double limit = s_.max_error * std::max(1.0, 2.0 - 0.25 * iteration);
      for (std::size_t i = 0; i < sights_.size(); ++i) {
        Sight moved = sights_[i];
        moved.p_world += offset[moved.wall] * moved.shift;
        if (errorOf(moved, T_b_world) < limit) inliers->push_back(static_cast<int>(i));
      }
    }
    return false;
  }

  /// Adds a sight to the normal equations; returns its weighted square.
  double add(const Sight& sight, const Pose& T_world_b, double offset, Eigen::MatrixXd* H, Eigen::VectorXd* g) const {
    const Eigen::Matrix3d R_b_world = T_world_b.linear().transpose();
    const Eigen::Vector3d q = sight.p_world + offset * sight.shift - T_world_b.translation();
    const double distance = q.norm();
    const Eigen::Vector3d d = R_b_world * q / distance;
    Eigen::Matrix<double, 2, 3> across;
    across.row(0) = sight.bearing.unitOrthogonal();
    across.row(1) = sight.bearing.cross(across.row(0).transpose());
    const Eigen::Vector2d r = across * d;
    const Eigen::Matrix<double, 2, 3> by_point =
        across * (Eigen::Matrix3d::Identity() - d * d.transpose()) * R_b_world / distance;
    Eigen::Matrix<double, 2, 7> J;
    J.leftCols<3>() = -by_point;
    J.middleCols<3>(3) = by_point * air_ground_common::skew(q);
    J.col(6) = by_point * sight.shift;
    const double relief = s_.relief_stddev * J.col(6).norm();
    const double variance = s_.bearing_stddev * s_.bearing_stddev + relief * relief;
    const double square = r.squaredNorm() / variance;
    const double weight = 1 / (variance * (1 + square / 9));  // Cauchy, at three standard deviations
    const int w = 6 + sight.wall;
    const Eigen::Matrix<double, 7, 7> JJ = weight * J.transpose() * J;
    const Eigen::Matrix<double, 7, 1> Jr = weight * J.transpose() * r;
    H->topLeftCorner<6, 6>() += JJ.topLeftCorner<6, 6>();
    H->block<6, 1>(0, w) += JJ.topRightCorner<6, 1>();
    H->block<1, 6>(w, 0) += JJ.bottomLeftCorner<1, 6>();
    (*H)(w, w) += JJ(6, 6);
    g->head<6>() += Jr.head<6>();
    (*g)(w) += Jr(6);
    return square / (1 + square / 9);
  }

  /// Whether several facades hold the pose.
  bool spread(const std::vector<int>& inliers) const {
    std::vector<int> on_wall(walls_, 0);
    for (const int i : inliers) ++on_wall[sights_[i].wall];
    const auto walls = std::count_if(on_wall.begin(), on_wall.end(), [&](int n) { return n >= s_.min_on_wall; });
    return walls >= 2 &&
           *std::max_element(on_wall.begin(), on_wall.end()) <= s_.max_share * static_cast<double>(inliers.size());
  }

  static constexpr double kLeastUpright = 0.9;  // cosine of a tilt that no panorama has
  const RelativePoseSettings& s_;
  std::vector<Sight> sights_;
  int walls_ = 0;
};

}  // namespace

std::optional<RelativePose> measureRelativePose(const BearingFeatures& a, const Pose& T_world_a,
                                                const BearingFeatures& b, const std::vector<Match>& matches,
                                                const BackProjector& projector, const RelativePoseSettings& settings) {
  Solver solver(settings);
  solver.cast(a, T_world_a, b, matches, projector);
  return solver.solve(T_world_a);
}

RelativePose inverted(const RelativePose& relative) {
  RelativePose result = relative;
  result.T_a_b = relative.T_a_b.inverse();
  const Eigen::Vector3d lever = -relative.T_a_b.translation();  // from b's place to a's, in a's axes
  result.covariance =
      air_ground_common::aboutAxes(result.T_a_b.linear(), air_ground_common::covarianceAt(relative.covariance, lever));
  return result;
}

}  // namespace streetview_localizer
