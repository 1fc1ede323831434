#include "pose_covariance.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "wall_offsets.h"

namespace streetview_localizer::detail {

namespace {

using Matrix26 = Eigen::Matrix<double, 2, 6>;
using Matrix63 = Eigen::Matrix<double, 6, 3>;
using Vector6 = air_ground_common::Vector6d;

struct Row {
  Eigen::Vector2d error;                 ///< [px]
  Matrix26 by_pose;                      ///< in (position, rotation about world axes)
  Eigen::Matrix<double, 2, 3> by_point;  ///< in the point in world
};

// e = w (pi(R' (p - t)) - u); with R = exp(a) R: d(R' exp(-a) (p - t)) / da = R' [p - t]x.
Row linearise(const visual_frontend::PoseCorrespondence& c, const Pose& T) {
  const Eigen::Matrix3d Rt = T.linear().transpose();
  const Eigen::Vector3d q = c.p_map - T.translation(), p = Rt * q;
  Eigen::Matrix<double, 2, 3> projection;
  projection << 1 / p.z(), 0, -p.x() / (p.z() * p.z()), 0, 1 / p.z(), -p.y() / (p.z() * p.z());
  Row row;
  row.error = (p.head<2>() / p.z() - c.normalized) / c.sigma;
  row.by_point = projection * Rt / c.sigma;
  row.by_pose.leftCols<3>() = -row.by_point;
  row.by_pose.rightCols<3>() = row.by_point * air_ground_common::skew(q);
  return row;
}

/// How a point cast from the panorama onto a wall moves with the panorama's position and orientation (columns 0-2, 3-5)
/// and with the wall's offset along its normal (column 6).
Eigen::Matrix<double, 3, 7> castJacobian(const Eigen::Vector3d& p, const Eigen::Vector3d& normal,
                                         const Eigen::Vector3d& centre) {
  const Eigen::Vector3d ray = p - centre, direction = castDirection(p, normal, centre);
  Eigen::Matrix<double, 3, 7> J = Eigen::Matrix<double, 3, 7>::Zero();
  if (direction.isZero()) return J;
  const Eigen::Matrix3d slide = Eigen::Matrix3d::Identity() - direction * unitNormal(normal, ray).transpose();
  J.leftCols<3>() = slide;
  J.middleCols<3>(3) = -slide * air_ground_common::skew(ray);
  J.col(6) = direction;
  return J;
}

/// Errors of neighbouring matches are alike (relief that the model lacks): how much larger the scatter of the image's
/// cells is than independent noise would make it (clustered sandwich estimator, Liang and Zeger 1986, as one factor >=
/// 1).
double clusterInflation(const Matches& m, const std::vector<int>& inliers, const std::vector<Row>& rows,
                        const Matrix6d& H_inverse, double variance) {
  double u_min = 1e9, u_max = -1e9, v_min = 1e9, v_max = -1e9;
  for (const int i : inliers) {
    u_min = std::min<double>(u_min, m.u[i]);
    u_max = std::max<double>(u_max, m.u[i]);
    v_min = std::min<double>(v_min, m.v[i]);
    v_max = std::max<double>(v_max, m.v[i]);
  }
  constexpr int kCells = 6;
  std::map<int, Vector6> cells;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const int cx =
        std::min(kCells - 1, static_cast<int>(kCells * (m.u[inliers[k]] - u_min) / std::max(1e-9, u_max - u_min)));
    const int cy =
        std::min(kCells - 1, static_cast<int>(kCells * (m.v[inliers[k]] - v_min) / std::max(1e-9, v_max - v_min)));
    const auto entry = cells.emplace(kCells * cy + cx, Vector6::Zero()).first;
    entry->second += rows[k].by_pose.transpose() * rows[k].error;
  }
  const double count = static_cast<double>(cells.size());
  if (count < 8) return 1;
  double sum = 0;
  for (const auto& cell : cells) sum += cell.second.dot(H_inverse * cell.second);
  return std::max(1.0, sum / (6 * variance) * count / (count - 3));
}

}  // namespace

namespace {

// Errors that many points share do not average out. The walls' offsets are estimated with the pose, from their spread
// and the matches; the panorama's pose is not: the estimate moves with it, d(pose, offsets) = -P sum J' e_p dp. So it
// does with what stands out from the walls: estimated as well, but relief does not keep to the patches of this grid.
Matrix6d totalCovariance(const Matches& m, const std::vector<int>& inliers, const std::vector<Row>& rows,
                         const Matrix6d& information, double variance, const PointSource& source) {
  std::map<int, int> column_of;
  for (const int i : inliers)
    if (source.model_lateral_stddev > 0) column_of.try_emplace(m.wall[i], 6 + static_cast<int>(column_of.size()));
  const int size = 6 + static_cast<int>(column_of.size());
  Eigen::MatrixXd joint = Eigen::MatrixXd::Zero(size, size), by_source = Eigen::MatrixXd::Zero(size, 6);
  std::map<Patch, Eigen::VectorXd> by_patch;
  joint.topLeftCorner<6, 6>() = information;
  for (int w = 6; w < size; ++w) joint(w, w) = 1 / (source.model_lateral_stddev * source.model_lateral_stddev);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const int i = inliers[k];
    const Eigen::Matrix<double, 2, 7> moved =
        rows[k].by_point * castJacobian(m.points[i].p_map, m.normals[i], m.centreOf(i, source));
    const Eigen::Matrix<double, 6, 2> pose = rows[k].by_pose.transpose() / variance;
    by_source.topRows<6>() += pose * moved.leftCols<6>();
    const Eigen::RowVector2d offset = moved.col(6).transpose() / variance;
    const auto wall = column_of.find(m.wall[i]);
    const bool wall_moves = wall != column_of.end();
    if (wall_moves) {
      joint.block<6, 1>(0, wall->second) += pose * moved.col(6);
      joint.block<1, 6>(wall->second, 0) += offset * rows[k].by_pose;
      joint(wall->second, wall->second) += offset * moved.col(6);
      by_source.row(wall->second) += offset * moved.leftCols<6>();
    }
    if (m.wall[i] < 0 || !(source.model_relief_stddev > 0)) continue;
    Eigen::VectorXd& by_relief = by_patch.try_emplace(patchOf(m, i), Eigen::VectorXd::Zero(size)).first->second;
    by_relief.head<6>() += pose * moved.col(6);
    if (wall_moves) by_relief[wall->second] += offset.dot(moved.col(6));
  }
  const Eigen::LDLT<Eigen::MatrixXd> factor(joint);
  const Matrix6d gain = factor.solve(by_source).topRows<6>();
  Vector6 source_variance;
  source_variance.head<3>().setConstant(source.position_stddev * source.position_stddev);
  source_variance.tail<3>().setConstant(source.orientation_stddev * source.orientation_stddev);
  Matrix6d total = factor.solve(Eigen::MatrixXd::Identity(size, 6)).topRows<6>();
  total += gain * source_variance.asDiagonal() * gain.transpose();
  for (const auto& patch : by_patch) {
    const Vector6 moved = source.model_relief_stddev * factor.solve(patch.second).head<6>();
    total += moved * moved.transpose();
  }
  total(2, 2) += source.model_height_stddev * source.model_height_stddev;
  return 0.5 * (total + total.transpose());
}

}  // namespace

std::optional<PoseCovariance> poseCovariance(const Matches& m, const std::vector<int>& inliers, const Pose& T,
                                             const PointSource& source, const PosePrior& prior,
                                             const PoseSettings& settings) {
  std::vector<Row> rows;
  Matrix6d H = Matrix6d::Zero();
  double squares = 0;
  for (const int i : inliers) {
    rows.push_back(linearise(m.points[i], T));
    H += rows.back().by_pose.transpose() * rows.back().by_pose;
    squares += rows.back().error.squaredNorm();
  }
  const double freedom = 2.0 * static_cast<double>(inliers.size()) - 6;
  if (freedom <= 0) return std::nullopt;
  PoseCovariance result;
  result.noise = std::max(settings.pixel_stddev, std::sqrt(squares / freedom));
  const double variance = result.noise * result.noise;
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(H);
  if (!(eigen.eigenvalues()[0] > 1e-12 * eigen.eigenvalues()[5])) return std::nullopt;
  const Matrix6d H_inverse =
      eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose();
  const double inflation = clusterInflation(m, inliers, rows, H_inverse, squares / freedom);

  // Gravity: up = R up_camera, seen tilted about the world's x and y.
  Matrix6d information = H / (variance * inflation);
  if (prior.up_camera) {
    information(3, 3) += 1 / (prior.up_stddev * prior.up_stddev);
    information(4, 4) += 1 / (prior.up_stddev * prior.up_stddev);
  }
  result.image = information.inverse();
  result.image = 0.5 * (result.image + result.image.transpose()).eval();

  result.total = totalCovariance(m, inliers, rows, information, variance * inflation, source);
  if (!result.total.allFinite()) return std::nullopt;
  return result;
}

std::optional<Matrix6d> monteCarloCovariance(const Matches& m, const std::vector<int>& inliers, const Pose& T,
                                             const PointSource& source, const PoseSettings& settings, int* plausible) {
  *plausible = 0;
  constexpr int kSample = 5;
  if (static_cast<int>(inliers.size()) < kSample) return std::nullopt;
  std::mt19937 generator(settings.seed);
  std::vector<Vector6> samples;
  for (int round = 0; round < settings.monte_carlo_samples; ++round) {
    int sample[kSample];
    for (int i = 0; i < kSample; ++i) {
      do sample[i] = inliers[generator() % inliers.size()];
      while (std::find(sample, sample + i, sample[i]) != sample + i);
    }
    Eigen::Matrix3d points, rays;
    for (int i = 0; i < 3; ++i) {
      points.col(i) = m.points[sample[i]].p_map;
      rays.col(i) = m.points[sample[i]].normalized.homogeneous();
    }
    const visual_frontend::P3PSolutions solutions = visual_frontend::solveP3PFixed(points, rays);
    int best = -1;
    double best_error = 1e11;  // in front of the camera
    for (int s = 0; s < solutions.size; ++s) {
      Pose candidate = Pose::Identity();
      candidate.linear() = solutions.R_map_camera[s];
      candidate.translation() = solutions.t_map_camera[s];
      const Pose inverse = candidate.inverse();
      const double error = squaredError(m, sample[3], inverse) + squaredError(m, sample[4], inverse);
      if (error < best_error) {
        best_error = error;
        best = s;
      }
    }
    if (best < 0 || (solutions.t_map_camera[best] - source.position).norm() > settings.max_range) continue;
    Vector6 e;
    e.head<3>() = solutions.t_map_camera[best] - T.translation();
    e.tail<3>() = air_ground_common::logSO3(solutions.R_map_camera[best] * T.linear().transpose());
    samples.push_back(e);
  }
  *plausible = static_cast<int>(samples.size());
  if (samples.size() < 10) return std::nullopt;
  Vector6 mean = Vector6::Zero();
  for (const Vector6& e : samples) mean += e / static_cast<double>(samples.size());
  Matrix6d covariance = Matrix6d::Zero();
  for (const Vector6& e : samples)
    covariance += (e - mean) * (e - mean).transpose() / static_cast<double>(samples.size() - 1);
  return covariance;
}

}  // namespace streetview_localizer::detail
