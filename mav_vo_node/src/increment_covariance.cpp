#include "mav_vo/increment_covariance.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "five_point_kernel.h"

namespace mav_vo {

namespace {
constexpr int kSample = 5;
constexpr double kRoot = 1e-9;  // residual of unit rays that counts as solved
/// Of normalised coordinates, after the turn R_previous_current is taken out.
double medianParallax(const std::vector<RayPair>& pairs, const Eigen::Matrix3d& R) {
  std::vector<double> parallax;
  for (const RayPair& pair : pairs) {
    const Eigen::Vector3d turned = R * pair.current.homogeneous();
    parallax.push_back(turned.z() > 1e-6 ? (turned.head<2>() / turned.z() - pair.previous).norm() : 0.0);
  }
  const auto middle = parallax.begin() + static_cast<std::ptrdiff_t>(parallax.size() / 2);
  std::nth_element(parallax.begin(), middle, parallax.end());
  return *middle;
}

}  // namespace

FivePointSolutions solveFivePoint(const std::vector<RayPair>& pairs, const std::vector<int>& samples,
                                  const Pose& start) {
  constexpr int L = kFivePointLanes;
  if (samples.size() % kSample != 0) throw std::invalid_argument("solveFivePoint: needs five indices for each problem");
  if (!(start.translation().norm() > 0))
    throw std::invalid_argument("solveFivePoint: the starting translation has no direction");
  for (const int i : samples) {
    if (i < 0 || static_cast<std::size_t>(i) >= pairs.size())
      throw std::invalid_argument("solveFivePoint: an index lies outside the pairs");
  }
  std::vector<Eigen::Vector3d> p(pairs.size()), c(pairs.size());
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    p[i] = pairs[i].previous.homogeneous().normalized();
    c[i] = pairs[i].current.homogeneous().normalized();
  }
  const Eigen::Quaterniond q0(start.linear());
  const Eigen::Vector3d t0 = start.translation().normalized();
  const double rotation0[4] = {q0.w(), q0.x(), q0.y(), q0.z()};
  const int problems = static_cast<int>(samples.size()) / kSample;
  FivePointSolutions out;
  out.R_previous_current.resize(problems);
  out.t_previous_current.resize(problems);
  out.converged.resize(problems);
  double rays_p[kSample * 3 * L], rays_c[kSample * 3 * L], q[4 * L], t[3 * L], residual[L];
  for (int first = 0; first < problems; first += L) {
    for (int l = 0; l < L; ++l) {
      const int problem = std::min(first + l, problems - 1);  // the last block repeats its last
      for (int i = 0; i < kSample; ++i) {
        const int index = samples[kSample * problem + i];
        for (int k = 0; k < 3; ++k) {
          rays_p[(3 * i + k) * L + l] = p[index][k];
          rays_c[(3 * i + k) * L + l] = c[index][k];
        }
      }
      for (int k = 0; k < 4; ++k) q[k * L + l] = rotation0[k];
      for (int k = 0; k < 3; ++k) t[k * L + l] = t0[k];
    }
    fivePointNewton(rays_p, rays_c, q, t, residual);
    for (int l = 0; l < L && first + l < problems; ++l) {
      out.R_previous_current[first + l] =
          Eigen::Quaterniond(q[l], q[L + l], q[2 * L + l], q[3 * L + l]).toRotationMatrix();
      out.t_previous_current[first + l] = Eigen::Vector3d(t[l], t[L + l], t[2 * L + l]);
      out.converged[first + l] = residual[l] < kRoot;
    }
  }
  return out;
}

MonteCarloCovariance monteCarloIncrement(const std::vector<RayPair>& pairs, const Pose& T_base,
                                         const Pose& T_base_camera, const Eigen::Matrix3d& R_map_base,
                                         double length_variance, double sigma, const MonteCarloSettings& settings) {
  MonteCarloCovariance result;
  const int n = static_cast<int>(pairs.size());
  if (n < 8) {
    result.reason = "only " + std::to_string(n) + " correspondences";
    return result;
  }
  const Pose T_camera = T_base_camera.inverse() * T_base * T_base_camera;
  const double length = T_camera.translation().norm();
  if (!(length > 1e-9) || !(medianParallax(pairs, T_camera.linear()) > settings.min_parallax * sigma)) {
    result.reason = "no parallax: the direction of the motion is open";
    return result;
  }
  std::mt19937 generator(settings.seed);
  std::vector<int> samples(static_cast<std::size_t>(kSample) * settings.samples);
  for (auto it = samples.begin(); it != samples.end(); it += kSample) {
    for (auto at = it; at != it + kSample; ++at) {
      do *at = static_cast<int>(generator() % n);
      while (std::find(it, at, *at) != at);
    }
  }
  const FivePointSolutions solutions = solveFivePoint(pairs, samples, T_camera);

  // Increments of base_link: the lever arm makes its translation depend on the rotation.
  const Eigen::Vector3d estimate = T_base.translation(), lever = T_base_camera.translation();
  const Eigen::Matrix3d R_bc = T_base_camera.linear();
  const Eigen::Vector3d vertical = R_map_base.row(2).transpose();  // the map's z in the earlier base_link
  std::vector<Eigen::Vector4d> scatter;
  Eigen::Vector4d mean = Eigen::Vector4d::Zero();
  for (std::size_t k = 0; k < solutions.converged.size(); ++k) {
    if (!solutions.converged[k]) continue;
    const Eigen::Matrix3d R = R_bc * solutions.R_previous_current[k] * R_bc.transpose();
    Eigen::Vector4d e;
    e.head<3>() = R_bc * (length * solutions.t_previous_current[k]) + lever - R * lever - estimate;
    e[3] = vertical.dot(air_ground_common::logSO3(R * T_base.linear().transpose()));
    if (!e.allFinite()) continue;
    scatter.push_back(e);
    mean += e;
  }
  result.converged = static_cast<int>(scatter.size());
  if (result.converged < std::max(10.0, settings.min_converged * settings.samples)) {
    result.reason = "only " + std::to_string(result.converged) + " of " + std::to_string(settings.samples) +
                    " samples have a solution near the motion";
    return result;
  }
  mean /= result.converged;
  for (const Eigen::Vector4d& e : scatter)
    result.covariance += (e - mean) * (e - mean).transpose() / (result.converged - 1.0);
  const Eigen::Vector3d along = R_bc * T_camera.translation() / length;
  result.covariance.topLeftCorner<3, 3>() += length_variance * along * along.transpose();
  result.success = true;
  return result;
}

}  // namespace mav_vo
