#include "streetview_localizer/point_fusion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <utility>

namespace streetview_localizer {
namespace {

using air_ground_common::expSO3;
using air_ground_common::skew;
using air_ground_common::Vector6d;

constexpr double kCauchy = 2;          // scale of the robust loss, in standard deviations
constexpr double kMinIncidence = 0.1;  // cosine; keeps the plane's information about a grazing ray finite

struct System {
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  double cost = 0;
  int points = 0;
};

// Parameters: translation and rotation vector about the optical centre, both in world, as in PoseResult::covariance.
System linearise(const std::vector<FusedPoint>& points, const CameraModel& camera, const PosePrior& prior,
                 const Pose& T, const PointFusionSettings& settings) {
  System s;
  const Eigen::Matrix3d R = T.linear().transpose();  // camera from world
  for (const FusedPoint& p : points) {
    const Eigen::Vector3d d = p.p_world - T.translation();
    Eigen::Matrix<double, 2, 3> J_camera;
    const auto pixel = camera.project(R * d, &J_camera);
    if (!pixel) continue;
    const Eigen::Matrix<double, 2, 3> J_world = J_camera * R;
    const Eigen::Matrix2d S =
        std::pow(settings.pixel_stddev, 2) * Eigen::Matrix2d::Identity() + J_world * p.covariance * J_world.transpose();
    const Eigen::Matrix2d W = S.inverse();
    const Eigen::Vector2d r = p.pixel - *pixel;
    const double m2 = r.dot(W * r), c2 = kCauchy * kCauchy;
    s.cost += c2 * std::log1p(m2 / c2);
    ++s.points;
    const double weight = 1 / (1 + m2 / c2);
    Eigen::Matrix<double, 2, 6> J;  // d pixel / d (translation, rotation)
    J.leftCols<3>() = -J_world;
    J.rightCols<3>() = J_world * skew(d);
    s.H += weight * J.transpose() * W * J;
    s.g += weight * J.transpose() * W * r;
  }
  if (prior.up_camera) {
    const Eigen::Vector3d up = T.linear() * prior.up_camera->normalized();  // should be z
    const Eigen::Vector3d r = Eigen::Vector3d::UnitZ() - up;
    Eigen::Matrix<double, 3, 6> J = Eigen::Matrix<double, 3, 6>::Zero();
    J.rightCols<3>() = -skew(up);
    const double w = 1 / std::pow(prior.up_stddev, 2);
    s.H += w * J.transpose() * J;
    s.g += w * J.transpose() * r;
    s.cost += w * r.squaredNorm();
  }
  return s;
}

}  // namespace

void PointFusionSettings::validate() const {
  if (!(surface_stddev > 0) || !std::isfinite(surface_stddev))
    throw std::invalid_argument("point fusion: surface_stddev must be positive");
  if (!(pixel_stddev > 0) || !std::isfinite(pixel_stddev))
    throw std::invalid_argument("point fusion: pixel_stddev must be positive");
  if (max_iterations < 1) throw std::invalid_argument("point fusion: max_iterations must be at least 1");
}

std::vector<FusedPoint> fusePoints(const std::vector<Correspondence>& correspondences, const std::vector<ViewRay>& rays,
                                   const std::vector<int>& use, const PointFusionSettings& settings) {
  settings.validate();
  if (rays.size() != correspondences.size())
    throw std::invalid_argument("point fusion: one ray a correspondence is needed");
  struct Sum {
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
  };
  std::vector<FusedPoint> points;
  std::vector<Sum> sums;
  std::map<std::pair<double, double>, std::size_t> at_pixel;
  for (const int index : use) {
    if (index < 0 || index >= static_cast<int>(correspondences.size()))
      throw std::invalid_argument("point fusion: index out of range");
    const Correspondence& c = correspondences[static_cast<std::size_t>(index)];
    const ViewRay& ray = rays[static_cast<std::size_t>(index)];
    const double range = std::max((c.p_world - ray.centre).norm(), 1e-3);
    const Eigen::Vector3d d = (c.p_world - ray.centre) / range;
    const auto [it, is_new] = at_pixel.try_emplace({c.pixel.x(), c.pixel.y()}, points.size());
    if (is_new) {
      FusedPoint point;
      point.pixel = c.pixel;
      points.push_back(point);
      Sum sum;
      const Eigen::Vector3d n =
          c.normal.squaredNorm() > 0.25 && std::abs(c.normal.dot(d)) > kMinIncidence ? c.normal : Eigen::Vector3d(-d);
      sum.A = n * n.transpose() / std::pow(settings.surface_stddev, 2);
      sum.b = sum.A * c.p_world;
      sums.push_back(sum);
    }
    const double lateral = std::hypot(settings.pixel_stddev * ray.pixel_angle * range, ray.centre_stddev);
    const Eigen::Matrix3d across = (Eigen::Matrix3d::Identity() - d * d.transpose()) / (lateral * lateral);
    sums[it->second].A += across;
    sums[it->second].b += across * c.p_world;
    ++points[it->second].sightings;
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i].covariance = sums[i].A.inverse();
    points[i].p_world = points[i].covariance * sums[i].b;
  }
  return points;
}

FusedRefinement refineOnFusedPoints(const std::vector<FusedPoint>& points, const CameraModel& camera,
                                    const PosePrior& prior, const Pose& start, const PointFusionSettings& settings) {
  settings.validate();
  FusedRefinement result;
  result.T_world_camera = start;
  System system = linearise(points, camera, prior, start, settings);
  double damping = 1e-4;
  for (int i = 0; i < settings.max_iterations && system.points >= 4; ++i) {
    Matrix6d H = system.H;
    H.diagonal() *= 1 + damping;
    const Vector6d step = H.ldlt().solve(system.g);
    if (!step.allFinite()) break;
    Pose T = result.T_world_camera;
    T.translation() += step.head<3>();
    T.linear() = expSO3(step.tail<3>()) * T.linear();
    const System next = linearise(points, camera, prior, T, settings);
    if (next.points == system.points && next.cost <= system.cost) {
      result.converged = system.cost - next.cost < 1e-6 * (1 + next.cost);
      result.T_world_camera = air_ground_common::normalized(T);
      system = next;
      damping = std::max(damping / 10, 1e-9);
      if (result.converged) break;
    } else {
      damping *= 10;
      if (damping > 1e8) {  // no step lowers the cost: at the minimum as far as rounding lets
        result.converged = step.norm() < 1e-3;
        break;
      }
    }
  }
  result.points = system.points;
  const Eigen::LDLT<Matrix6d> factor(system.H);
  if (system.points >= 4 && factor.isPositive() && factor.vectorD().minCoeff() > 0) {
    result.covariance = factor.solve(Matrix6d::Identity());
    result.covariance = (0.5 * (result.covariance + result.covariance.transpose())).eval();
  } else {
    result.converged = false;
  }
  return result;
}

}  // namespace streetview_localizer
