#include "visual_frontend/triangulation.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace visual_frontend {

const char* toString(TriangulationStatus status) {
  switch (status) {
    case TriangulationStatus::kOk:
      return "ok";
    case TriangulationStatus::kTooFewViews:
      return "too few views";
    case TriangulationStatus::kLowParallax:
      return "low parallax";
    case TriangulationStatus::kBehindCamera:
      return "behind a camera";
    case TriangulationStatus::kDepthRange:
      return "depth out of range";
    case TriangulationStatus::kLargeResidual:
      return "large residual";
    case TriangulationStatus::kSingular:
      return "singular";
  }
  return "unknown";
}

namespace {

struct System {
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
  Eigen::Vector3d g = Eigen::Vector3d::Zero();
  double cost = 0;
  bool in_front = true;
};

System build(const std::vector<ViewRay>& views, const Eigen::Vector3d& p_map) {
  System s;
  for (const ViewRay& v : views) {
    const Eigen::Matrix3d Rt = v.T_map_camera.linear().transpose();
    const Eigen::Vector3d p = Rt * (p_map - v.T_map_camera.translation());
    if (!(p.z() > 1e-6)) {
      s.in_front = false;
      return s;
    }
    const double iz = 1 / p.z();
    const Eigen::Matrix2d W = whitening(v.normalized, {v.sigma, v.elongation});
    const Eigen::Vector2d r = W * (p.head<2>() * iz - v.normalized);
    Eigen::Matrix<double, 2, 3> J;
    J << iz, 0, -p.x() * iz * iz, 0, iz, -p.y() * iz * iz;
    J = (W * J * Rt).eval();
    s.H += J.transpose() * J;
    s.g += J.transpose() * r;
    s.cost += r.squaredNorm();
    if (v.depth > 0) {
      const double rd = (p.z() - v.depth) / v.depth_sigma;
      const Eigen::Vector3d Jd = Rt.row(2).transpose() / v.depth_sigma;
      s.H += Jd * Jd.transpose();
      s.g += rd * Jd;
      s.cost += rd * rd;
    }
  }
  return s;
}

/// Largest angle between two of the unit directions [rad].
double largestAngle(const std::vector<Eigen::Vector3d>& directions) {
  double largest = 0;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    for (std::size_t j = i + 1; j < directions.size(); ++j) {
      // atan2 keeps its precision for small angles, where acos does not.
      const double angle = std::atan2(directions[i].cross(directions[j]).norm(), directions[i].dot(directions[j]));
      largest = std::max(largest, angle);
    }
  }
  return largest;
}

/// Where the measured depths put the point, each by its weight.
Eigen::Vector3d meanByDepth(const std::vector<ViewRay>& views) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weight = 0;
  for (const ViewRay& v : views) {
    if (!(v.depth > 0)) continue;
    const double w = 1 / (v.depth_sigma * v.depth_sigma);
    sum += w * (v.T_map_camera * (v.depth * v.normalized.homogeneous()));
    weight += w;
  }
  return sum / weight;
}

/// Point nearest to all rays; `directions`: theirs, of unit length, in the map.
Eigen::Vector3d nearestToRays(const std::vector<ViewRay>& views, const std::vector<Eigen::Vector3d>& directions) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < views.size(); ++i) {
    const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - directions[i] * directions[i].transpose();
    A += P;
    b += P * views[i].T_map_camera.translation();
  }
  return A.ldlt().solve(b);
}

/// Levenberg-Marquardt from p, which becomes the best point found; `s`: built there, before and after.
void minimise(const std::vector<ViewRay>& views, int max_iterations, Eigen::Vector3d* p, System* s) {
  double lambda = 1e-6;
  for (int i = 0; i < max_iterations; ++i) {
    Eigen::Matrix3d H = s->H;
    H.diagonal() *= 1 + lambda;
    const Eigen::Vector3d step = -H.ldlt().solve(s->g);
    if (!step.allFinite()) break;
    const System trial = build(views, *p + step);
    if (trial.in_front && trial.cost <= s->cost) {
      *p += step;
      *s = trial;
      lambda = std::max(1e-9, 0.1 * lambda);
      if (step.norm() < 1e-7 * p->norm()) break;
    } else {
      lambda = std::max(1e-4, 10 * lambda);
    }
  }
}

}  // namespace

TriangulationResult triangulate(const std::vector<ViewRay>& views, const TriangulationSettings& settings) {
  TriangulationResult result;
  const bool any_depth = std::any_of(views.begin(), views.end(), [](const ViewRay& v) { return v.depth > 0; });
  if (views.empty() || (views.size() < 2 && !any_depth)) return result;

  std::vector<Eigen::Vector3d> directions;
  for (const ViewRay& v : views)
    directions.push_back((v.T_map_camera.linear() * v.normalized.homogeneous()).normalized());
  result.parallax = largestAngle(directions);
  if (!any_depth && result.parallax < settings.min_parallax) {
    result.status = TriangulationStatus::kLowParallax;
    return result;
  }

  Eigen::Vector3d p = any_depth ? meanByDepth(views) : nearestToRays(views, directions);
  result.p_map = p;
  System s = build(views, p);
  if (!s.in_front || !p.allFinite()) {
    result.status = TriangulationStatus::kBehindCamera;
    return result;
  }
  minimise(views, settings.max_iterations, &p, &s);
  result.p_map = p;

  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(s.H);
  if (!(eigen.eigenvalues()[0] > 1e-12 * eigen.eigenvalues()[2])) {
    result.status = TriangulationStatus::kSingular;
    return result;
  }
  result.covariance =
      eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose();
  bool in_range = true;
  for (const ViewRay& v : views) {
    const Eigen::Vector3d q = v.T_map_camera.inverse() * p;
    in_range = in_range && q.z() >= settings.min_depth && q.z() <= settings.max_depth;
    const Eigen::Vector2d difference = q.head<2>() / q.z() - v.normalized;
    result.max_residual =
        std::max(result.max_residual, std::sqrt(squaredSigmas(difference, v.normalized, {v.sigma, v.elongation})));
    if (v.depth > 0) result.max_residual = std::max(result.max_residual, std::abs(q.z() - v.depth) / v.depth_sigma);
  }
  result.status = !in_range                                     ? TriangulationStatus::kDepthRange
                  : result.max_residual > settings.max_residual ? TriangulationStatus::kLargeResidual
                                                                : TriangulationStatus::kOk;
  return result;
}

}  // namespace visual_frontend
