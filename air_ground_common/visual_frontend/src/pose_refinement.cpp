#include <cmath>

#include "air_ground_common/linear_algebra.h"
#include "visual_frontend/pose_solver.h"

namespace visual_frontend {

namespace {

using air_ground_common::expSO3;
using air_ground_common::logSO3;
using air_ground_common::skew;

struct Weighted {
  double cost;    ///< rho(r^2)
  double weight;  ///< rho'(r^2)
};

Weighted robust(RobustLoss loss, double width, double squared) {
  const double w2 = width * width;
  switch (loss) {
    case RobustLoss::kHuber:
      if (squared <= w2) return {squared, 1};
      return {2 * width * std::sqrt(squared) - w2, width / std::sqrt(squared)};
    case RobustLoss::kCauchy:
      return {w2 * std::log1p(squared / w2), 1 / (1 + squared / w2)};
    case RobustLoss::kNone:
      break;
  }
  return {squared, 1};
}

/// Normal equations of the pose: perturbation (dc, dtheta): centre + dc, exp(dtheta) * R, both in the map frame.
struct Normal {
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  double cost = 0;
};

void addPrior(const Pose& T, const PosePrior& prior, Normal* n) {
  const Eigen::Matrix3d to_prior = prior.T_map_camera.linear().transpose();
  Vector6d e;
  e << to_prior * (T.translation() - prior.T_map_camera.translation()), logSO3(to_prior * T.linear());
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = to_prior;
  J.bottomRightCorner<3, 3>() = T.linear().transpose();  // to first order in the turn
  n->cost += e.dot(prior.information * e);
  n->H.noalias() += J.transpose() * prior.information * J;
  n->g.noalias() += J.transpose() * (prior.information * e);
}

class Problem {
 public:
  Problem(const std::vector<PoseCorrespondence>& c, const RefineSettings& s) : c_(c), s_(s), used_(c.size(), 1) {}

  std::vector<unsigned char>& used() { return used_; }

  /// Cost, and with `full` its Gauss-Newton system; `plain` leaves the loss out.
  Normal build(const Pose& T, bool full, bool plain) const {
    Normal n;
    const Eigen::Matrix3d Rt = T.linear().transpose();
    const RobustLoss loss = plain ? RobustLoss::kNone : s_.loss;
    for (std::size_t i = 0; i < c_.size(); ++i) {
      if (!used_[i]) continue;
      const Eigen::Vector3d q = c_[i].p_map - T.translation();
      const Eigen::Vector3d p = Rt * q;
      if (!(p.z() > 1e-3)) {
        n.cost += 1e6;  // a step that puts a used point behind the camera is no improvement
        continue;
      }
      const double iz = 1 / p.z();
      const Eigen::Matrix2d W = whitening(c_[i].normalized, {c_[i].sigma, c_[i].elongation});
      const Eigen::Vector2d r = W * (p.head<2>() * iz - c_[i].normalized);
      const Weighted w = robust(loss, s_.loss_width, r.squaredNorm());
      n.cost += w.cost;
      const bool depth = s_.use_depth && c_[i].depth > 0;
      if (full) {
        Eigen::Matrix<double, 3, 6> D;  // d p / d (c, theta)
        D.leftCols<3>() = -Rt;
        D.rightCols<3>() = Rt * skew(q);
        Eigen::Matrix<double, 2, 3> P;
        P << iz, 0, -p.x() * iz * iz, 0, iz, -p.y() * iz * iz;
        const Eigen::Matrix<double, 2, 6> J = W * P * D;
        n.H.noalias() += w.weight * J.transpose() * J;
        n.g.noalias() += w.weight * J.transpose() * r;
        if (depth) {
          const double rd = (p.z() - c_[i].depth) / c_[i].depth_sigma;
          const Weighted wd = robust(loss, s_.loss_width, rd * rd);
          const Vector6d Jd = D.row(2).transpose() / c_[i].depth_sigma;
          n.H.noalias() += wd.weight * Jd * Jd.transpose();
          n.g.noalias() += wd.weight * rd * Jd;
        }
      }
      if (depth) {
        const double rd = (p.z() - c_[i].depth) / c_[i].depth_sigma;
        n.cost += robust(loss, s_.loss_width, rd * rd).cost;
      }
    }
    if (s_.R_map_camera_prior) {
      const double is = 1 / s_.rotation_prior_sigma;
      const Eigen::Vector3d r = is * logSO3(T.linear() * s_.R_map_camera_prior->transpose());
      n.cost += r.squaredNorm();
      n.H.block<3, 3>(3, 3).diagonal().array() += is * is;
      n.g.tail<3>() += is * r;
    }
    if (s_.up_camera) {
      const double is = 1 / s_.up_sigma;
      const Eigen::Vector3d r = is * (Rt.col(2) - s_.up_camera->normalized());
      const Eigen::Matrix3d J = is * Rt * skew(Eigen::Vector3d::UnitZ());
      n.cost += r.squaredNorm();
      n.H.block<3, 3>(3, 3) += J.transpose() * J;
      n.g.tail<3>() += J.transpose() * r;
    }
    if (s_.prior) addPrior(T, *s_.prior, &n);
    return n;
  }

 private:
  const std::vector<PoseCorrespondence>& c_;
  const RefineSettings& s_;
  std::vector<unsigned char> used_;
};

int minimise(const Problem& problem, const RefineSettings& settings, Pose& T) {
  double lambda = 1e-6;
  Normal n = problem.build(T, true, false);
  int iteration = 0;
  for (; iteration < settings.max_iterations; ++iteration) {
    Matrix6d H = n.H;
    H.diagonal() *= 1 + lambda;
    H.diagonal().array() += 1e-12;
    const Vector6d step = -air_ground_common::solveSymmetric(H, n.g);
    if (!step.allFinite()) break;
    Pose trial = Pose::Identity();
    trial.translation() = T.translation() + step.head<3>();
    trial.linear() = expSO3(step.tail<3>()) * T.linear();
    trial = air_ground_common::normalized(trial);
    const Normal next = problem.build(trial, true, false);
    if (next.cost <= n.cost) {
      T = trial;
      n = next;
      lambda = std::max(1e-9, 0.1 * lambda);
    } else {
      lambda = std::max(1e-4, 10 * lambda);
      if (lambda > 1e6) break;
    }
    if (step.norm() < settings.min_step) break;
  }
  return iteration;
}

/// Sums of squared residuals of the inliers, in sigmas.
struct Residuals {
  double reprojection = 0, depth = 0;
  std::size_t with_depth = 0;
  int needed() const { return with_depth >= 3 ? 3 : 4; }  ///< inliers that fix a pose
};

/// Marks and counts the inliers of the result's pose. A wrong depth measurement does not make a wrong match: only the
/// image decides.
Residuals classify(const std::vector<PoseCorrespondence>& correspondences, const RefineSettings& settings,
                   PoseResult* result) {
  const Pose T_camera_map = result->T_map_camera.inverse();
  Residuals sums;
  result->inlier_count = 0;
  for (std::size_t i = 0; i < correspondences.size(); ++i) {
    const PoseCorrespondence& c = correspondences[i];
    const Eigen::Vector3d p = T_camera_map * c.p_map;
    const double e2 =
        p.z() > 1e-3 ? squaredSigmas(p.head<2>() / p.z() - c.normalized, c.normalized, {c.sigma, c.elongation}) : 1e12;
    result->inliers[i] = e2 < settings.inlier_threshold * settings.inlier_threshold;
    if (!result->inliers[i]) continue;
    ++result->inlier_count;
    sums.reprojection += e2;
    if (!settings.use_depth || !(c.depth > 0)) continue;
    const double rd = (p.z() - c.depth) / c.depth_sigma;
    if (std::abs(rd) >= settings.inlier_threshold) continue;
    ++sums.with_depth;
    sums.depth += rd * rd;
  }
  return sums;
}

}  // namespace

PoseResult refinePose(const std::vector<PoseCorrespondence>& correspondences, const Pose& initial,
                      const RefineSettings& settings, const std::vector<unsigned char>& chosen) {
  PoseResult result;
  result.T_map_camera = initial;
  result.inliers.assign(correspondences.size(), 0);
  if (!air_ground_common::isValid(initial)) {
    result.reason = "the initial pose is not finite or not a rotation";
    return result;
  }
  Problem problem(correspondences, settings);
  // First all points that lie in front, or of those the chosen ones, with the robust loss; then the inliers alone.
  const Pose T_camera_map = initial.inverse();
  for (std::size_t i = 0; i < correspondences.size(); ++i)
    problem.used()[i] = (chosen.empty() || chosen[i]) && (T_camera_map * correspondences[i].p_map).z() > 1e-3;
  Residuals residuals;
  for (int round = 0; round < 2; ++round) {
    if (round > 0) problem.used() = result.inliers;
    result.iterations += minimise(problem, settings, result.T_map_camera);
    residuals = classify(correspondences, settings, &result);
    if (settings.prior || result.inlier_count >= residuals.needed()) continue;
    result.reason =
        "only " + std::to_string(result.inlier_count) + " inliers of " + std::to_string(correspondences.size());
    return result;
  }

  problem.used() = result.inliers;
  // The loss also tames wrong depths here, so the covariance does not count them in full.
  const Matrix6d H = problem.build(result.T_map_camera, true, false).H;
  const auto eigen = air_ground_common::symmetricEigen(H);
  if (!(eigen.values[0] > 1e-9 * eigen.values[5])) {
    result.reason = "the points do not fix the pose (singular information)";
    return result;
  }
  const double dof = 2.0 * result.inlier_count + residuals.with_depth - 6;
  const double scale = dof > 0 ? std::max(1.0, (residuals.reprojection + residuals.depth) / dof) : 1.0;
  result.covariance = scale * (eigen.vectors * eigen.values.cwiseInverse().asDiagonal() * eigen.vectors.transpose());
  result.rms = std::sqrt(residuals.reprojection / (2.0 * std::max(1, result.inlier_count)));
  result.success = true;
  return result;
}

}  // namespace visual_frontend
