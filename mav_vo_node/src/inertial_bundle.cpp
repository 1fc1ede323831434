#include "mav_vo/inertial_bundle.h"

#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <cmath>
#include <memory>
#include <stdexcept>

#include "inertial_costs.h"

namespace mav_vo {

namespace {

using Vector6d = air_ground_common::Vector6d;
using visual_frontend::BundleProblem;

constexpr double kAnchorPosition = 1e-4;  // [m]
constexpr double kAnchorYaw = 1e-5;       // [rad]
constexpr double kLinkLossWidth = 6;      // sigmas of a whole link, of nine numbers: one in 10,000 true ones is longer

void check(const InertialBundleProblem& problem) {
  const std::size_t cameras = problem.visual.cameras.size();
  const auto fail = [](const char* what) { throw std::invalid_argument(std::string("solveInertialBundle: ") + what); };
  if (problem.states.size() != cameras || problem.state_fixed.size() != cameras) fail("one state a camera is needed");
  for (const auto& m : problem.visual.measurements) {
    if (m.camera < 0 || m.camera >= static_cast<int>(cameras) || m.point < 0 ||
        m.point >= static_cast<int>(problem.visual.points.size()))
      fail("a measurement's index is out of range");
    if (!m.normalized.allFinite() || !(m.sigma > 0)) fail("a measurement is not finite or its sigma not positive");
  }
  for (const auto& link : problem.links) {
    if (link.a < 0 || link.b < 0 || link.a >= static_cast<int>(cameras) || link.b >= static_cast<int>(cameras) ||
        link.a == link.b)
      fail("a link's index is out of range");
    if (!(link.motion.duration() > 0)) fail("a link without inertial samples");
  }
  if (problem.anchor >= static_cast<int>(cameras)) fail("the anchor is out of range");
}

double squaredError(const BundleProblem& problem, const BundleProblem::Measurement& m) {
  const air_ground_common::Pose& T = problem.cameras[m.camera].T_map_camera;
  const Eigen::Vector3d p = T.linear().transpose() * (problem.points[m.point] - T.translation());
  if (!(p.z() > 1e-4)) return 1e12;
  return visual_frontend::squaredSigmas(p.head<2>() / p.z() - m.normalized, m.normalized, {m.sigma, m.elongation});
}

struct Keyframe {
  Eigen::Matrix<double, 6, 1, Eigen::DontAlign> camera = Vector6d::Zero();  ///< centre, rotation vector from R_0
  Eigen::Vector3d velocity;
  Eigen::Matrix<double, 6, 1, Eigen::DontAlign> bias;  ///< gyro, accelerometer
};

}  // namespace

InertialBundleResult solveInertialBundle(InertialBundleProblem& problem, const InertialBundleSettings& settings) {
  check(problem);
  auto& visual = problem.visual;
  const std::size_t cameras = visual.cameras.size();
  // One array for all blocks: Ceres orders them by address, and the result must not depend on the allocator.
  std::vector<Keyframe> keyframe(cameras);
  std::vector<Eigen::Matrix3d> R_0(cameras);
  for (std::size_t i = 0; i < cameras; ++i) {
    keyframe[i].camera.head<3>() = visual.cameras[i].T_map_camera.translation();
    R_0[i] = visual.cameras[i].T_map_camera.linear();
    keyframe[i].velocity = problem.states[i].velocity;
    keyframe[i].bias << problem.states[i].bias.gyro, problem.states[i].bias.accel;
  }
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem solver_problem(options);
  std::unique_ptr<ceres::LossFunction> loss;
  if (settings.loss == visual_frontend::RobustLoss::kHuber)
    loss = std::make_unique<ceres::HuberLoss>(settings.loss_width);
  if (settings.loss == visual_frontend::RobustLoss::kCauchy)
    loss = std::make_unique<ceres::CauchyLoss>(settings.loss_width);
  // One link that a spoilt sample made false may not bend the map.
  const auto link_loss = std::make_unique<ceres::HuberLoss>(kLinkLossWidth);

  std::vector<unsigned char> camera_used(cameras, 0), state_used(cameras, 0), point_used(visual.points.size(), 0);
  for (const auto& m : visual.measurements) {
    if (squaredError(visual, m) >= 1e12) continue;
    solver_problem.AddResidualBlock(
        new visual_frontend::ReprojectionCost(R_0[m.camera], m.normalized, {m.sigma, m.elongation}), loss.get(),
        keyframe[m.camera].camera.data(), visual.points[m.point].data());
    camera_used[m.camera] = point_used[m.point] = 1;
  }
  for (const auto& link : problem.links) {
    Keyframe &a = keyframe[link.a], &b = keyframe[link.b];
    if (problem.metric) {
      solver_problem.AddResidualBlock(new InertialCost(R_0[link.a], R_0[link.b], problem.T_camera_imu, link.motion),
                                      link_loss.get(), a.camera.data(), a.velocity.data(), a.bias.data(),
                                      b.camera.data(), b.velocity.data());
    } else {
      solver_problem.AddResidualBlock(
          new GyroCost(R_0[link.a], R_0[link.b], problem.T_camera_imu.linear(), link.motion), link_loss.get(),
          a.camera.data(), a.bias.data(), b.camera.data());
    }
    const double root_dt = std::sqrt(link.motion.duration());
    solver_problem.AddResidualBlock(
        new BiasWalkCost(link.motion.noise().gyro_bias_walk * root_dt, link.motion.noise().accel_bias_walk * root_dt),
        nullptr, a.bias.data(), b.bias.data());
    camera_used[link.a] = camera_used[link.b] = state_used[link.a] = state_used[link.b] = 1;
  }
  // Where a chain of links begins, nothing else says what the bias was before.
  std::vector<unsigned char> has_predecessor(cameras, 0);
  for (const auto& link : problem.links) has_predecessor[link.b] = 1;
  int free_blocks = 0;
  ceres::Solver::Options solver;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < cameras; ++i) {
    if (!camera_used[i]) continue;
    ordering->AddElementToGroup(keyframe[i].camera.data(), 1);
    if (visual.cameras[i].fixed)
      solver_problem.SetParameterBlockConstant(keyframe[i].camera.data());
    else
      ++free_blocks;
    if (visual.cameras[i].up_camera && !visual.cameras[i].fixed)
      solver_problem.AddResidualBlock(
          new visual_frontend::GravityCost(R_0[i], *visual.cameras[i].up_camera, visual.cameras[i].up_sigma), nullptr,
          keyframe[i].camera.data());
    if (!state_used[i]) continue;
    if (problem.metric) ordering->AddElementToGroup(keyframe[i].velocity.data(), 1);
    ordering->AddElementToGroup(keyframe[i].bias.data(), 1);
    if (problem.state_fixed[i]) {
      if (problem.metric) solver_problem.SetParameterBlockConstant(keyframe[i].velocity.data());
      solver_problem.SetParameterBlockConstant(keyframe[i].bias.data());
    } else if (!has_predecessor[i]) {
      Vector6d sigma;
      sigma << Eigen::Vector3d::Constant(settings.gyro_bias_prior),
          Eigen::Vector3d::Constant(settings.accel_bias_prior);
      Vector6d mean = keyframe[i].bias;
      if (settings.gyro_bias_mean) mean.head<3>() = *settings.gyro_bias_mean;
      solver_problem.AddResidualBlock(new PriorCost(mean, sigma), nullptr, keyframe[i].bias.data());
    }
  }
  if (problem.anchor >= 0 && camera_used[problem.anchor]) {
    Vector6d sigma;
    sigma << Eigen::Vector3d::Constant(kAnchorPosition), 0, 0, kAnchorYaw;
    solver_problem.AddResidualBlock(new PriorCost(keyframe[problem.anchor].camera, sigma), nullptr,
                                    keyframe[problem.anchor].camera.data());
  }
  for (std::size_t i = 0; i < visual.points.size(); ++i)
    if (point_used[i]) ordering->AddElementToGroup(visual.points[i].data(), 0);

  solver.linear_solver_ordering = ordering;
  solver.linear_solver_type = free_blocks <= 25 ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  solver.max_num_iterations = settings.max_iterations;
  solver.max_solver_time_in_seconds = settings.max_seconds;
  solver.num_threads = settings.threads;
  solver.function_tolerance = 1e-5;
  solver.parameter_tolerance = 1e-8;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &solver_problem, &summary);

  InertialBundleResult result;
  result.usable = summary.IsSolutionUsable();
  result.message = summary.message;
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.iterations = static_cast<int>(summary.iterations.size());
  result.seconds = summary.total_time_in_seconds;
  if (result.usable) {
    for (std::size_t i = 0; i < cameras; ++i) {
      if (state_used[i] && !problem.state_fixed[i])
        problem.states[i] = {keyframe[i].velocity, {keyframe[i].bias.head<3>(), keyframe[i].bias.tail<3>()}};
      auto& c = visual.cameras[i];
      if (c.fixed || !camera_used[i]) continue;
      c.T_map_camera.translation() = keyframe[i].camera.head<3>();
      c.T_map_camera.linear() = air_ground_common::expSO3(keyframe[i].camera.tail<3>()) * R_0[i];
      c.T_map_camera = air_ground_common::normalized(c.T_map_camera);
    }
  }
  double sum = 0;
  std::size_t inliers = 0;
  for (std::size_t i = 0; i < visual.measurements.size(); ++i) {
    const double e2 = squaredError(visual, visual.measurements[i]);
    if (e2 > settings.outlier_threshold * settings.outlier_threshold) {
      result.outliers.push_back(static_cast<int>(i));
    } else {
      sum += e2;
      ++inliers;
    }
  }
  result.rms = inliers > 0 ? std::sqrt(sum / (2.0 * static_cast<double>(inliers))) : 0;
  return result;
}

}  // namespace mav_vo
