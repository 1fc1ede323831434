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

/// A problem as Ceres takes it, and back.
class Solver {
 public:
  Solver(InertialBundleProblem& problem, const InertialBundleSettings& settings)
      : problem_(problem),
        visual_(problem.visual),
        settings_(settings),
        keyframe_(visual_.cameras.size()),
        camera_used_(visual_.cameras.size(), 0),
        state_used_(visual_.cameras.size(), 0),
        point_used_(visual_.points.size(), 0),
        loss_(makeLoss(settings)),
        link_loss_(kLinkLossWidth),
        ceres_(borrowedLosses()),
        ordering_(std::make_shared<ceres::ParameterBlockOrdering>()) {
    for (std::size_t i = 0; i < keyframe_.size(); ++i) {
      keyframe_[i].camera.head<3>() = visual_.cameras[i].T_map_camera.translation();
      R_0_.push_back(visual_.cameras[i].T_map_camera.linear());
      keyframe_[i].velocity = problem.states[i].velocity;
      keyframe_[i].bias << problem.states[i].bias.gyro, problem.states[i].bias.accel;
    }
    addMeasurements();
    addLinks();
    addCameras();
    addAnchor();
    for (std::size_t i = 0; i < visual_.points.size(); ++i)
      if (point_used_[i]) ordering_->AddElementToGroup(visual_.points[i].data(), 0);
  }

  ceres::Solver::Summary solve() {
    ceres::Solver::Options options;
    options.linear_solver_ordering = ordering_;
    options.linear_solver_type = free_blocks_ <= 25 ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
    options.max_num_iterations = settings_.max_iterations;
    options.max_solver_time_in_seconds = settings_.max_seconds;
    options.num_threads = settings_.threads;
    options.function_tolerance = 1e-5;
    options.parameter_tolerance = 1e-8;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &ceres_, &summary);
    if (summary.IsSolutionUsable()) apply();
    return summary;
  }

 private:
  static ceres::Problem::Options borrowedLosses() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }

  static std::unique_ptr<ceres::LossFunction> makeLoss(const InertialBundleSettings& settings) {
    if (settings.loss == visual_frontend::RobustLoss::kHuber)
      return std::make_unique<ceres::HuberLoss>(settings.loss_width);
    if (settings.loss == visual_frontend::RobustLoss::kCauchy)
      return std::make_unique<ceres::CauchyLoss>(settings.loss_width);
    return nullptr;
  }

  void addMeasurements() {
    for (const auto& m : visual_.measurements) {
      if (squaredError(visual_, m) >= 1e12) continue;
      ceres_.AddResidualBlock(
          new visual_frontend::ReprojectionCost(R_0_[m.camera], m.normalized, {m.sigma, m.elongation}), loss_.get(),
          keyframe_[m.camera].camera.data(), visual_.points[m.point].data());
      camera_used_[m.camera] = point_used_[m.point] = 1;
    }
  }

  void addLinks() {
    for (const auto& link : problem_.links) {
      Keyframe &a = keyframe_[link.a], &b = keyframe_[link.b];
      if (problem_.metric) {
        ceres_.AddResidualBlock(new InertialCost(R_0_[link.a], R_0_[link.b], problem_.T_camera_imu, link.motion),
                                &link_loss_, a.camera.data(), a.velocity.data(), a.bias.data(), b.camera.data(),
                                b.velocity.data());
      } else {
        ceres_.AddResidualBlock(new GyroCost(R_0_[link.a], R_0_[link.b], problem_.T_camera_imu.linear(), link.motion),
                                &link_loss_, a.camera.data(), a.bias.data(), b.camera.data());
      }
      const double root_dt = std::sqrt(link.motion.duration());
      ceres_.AddResidualBlock(
          new BiasWalkCost(link.motion.noise().gyro_bias_walk * root_dt, link.motion.noise().accel_bias_walk * root_dt),
          nullptr, a.bias.data(), b.bias.data());
      camera_used_[link.a] = camera_used_[link.b] = state_used_[link.a] = state_used_[link.b] = 1;
    }
  }

  void addCameras() {
    std::vector<unsigned char> has_predecessor(keyframe_.size(), 0);
    for (const auto& link : problem_.links) has_predecessor[link.b] = 1;
    for (std::size_t i = 0; i < keyframe_.size(); ++i) {
      if (!camera_used_[i]) continue;
      const auto& camera = visual_.cameras[i];
      ordering_->AddElementToGroup(keyframe_[i].camera.data(), 1);
      if (camera.fixed)
        ceres_.SetParameterBlockConstant(keyframe_[i].camera.data());
      else
        ++free_blocks_;
      if (camera.up_camera && !camera.fixed)
        ceres_.AddResidualBlock(new visual_frontend::GravityCost(R_0_[i], *camera.up_camera, camera.up_sigma), nullptr,
                                keyframe_[i].camera.data());
      if (state_used_[i]) addState(i, has_predecessor[i]);
    }
  }

  void addState(std::size_t i, bool has_predecessor) {
    Keyframe& k = keyframe_[i];
    if (problem_.metric) ordering_->AddElementToGroup(k.velocity.data(), 1);
    ordering_->AddElementToGroup(k.bias.data(), 1);
    if (problem_.state_fixed[i]) {
      if (problem_.metric) ceres_.SetParameterBlockConstant(k.velocity.data());
      ceres_.SetParameterBlockConstant(k.bias.data());
    } else if (!has_predecessor) {
      // Where a chain of links begins, nothing else says what the bias was before.
      Vector6d sigma, mean = k.bias;
      sigma << Eigen::Vector3d::Constant(settings_.gyro_bias_prior),
          Eigen::Vector3d::Constant(settings_.accel_bias_prior);
      if (settings_.gyro_bias_mean) mean.head<3>() = *settings_.gyro_bias_mean;
      ceres_.AddResidualBlock(new PriorCost(mean, sigma), nullptr, k.bias.data());
    }
  }

  void addAnchor() {
    if (problem_.anchor < 0 || !camera_used_[problem_.anchor]) return;
    auto& camera = keyframe_[problem_.anchor].camera;
    Vector6d sigma;
    sigma << Eigen::Vector3d::Constant(kAnchorPosition), 0, 0, kAnchorYaw;
    ceres_.AddResidualBlock(new PriorCost(camera, sigma), nullptr, camera.data());
  }

  void apply() {
    for (std::size_t i = 0; i < keyframe_.size(); ++i) {
      const Keyframe& k = keyframe_[i];
      if (state_used_[i] && !problem_.state_fixed[i])
        problem_.states[i] = {k.velocity, {k.bias.head<3>(), k.bias.tail<3>()}};
      auto& c = visual_.cameras[i];
      if (c.fixed || !camera_used_[i]) continue;
      c.T_map_camera.translation() = k.camera.head<3>();
      c.T_map_camera.linear() = air_ground_common::expSO3(k.camera.tail<3>()) * R_0_[i];
      c.T_map_camera = air_ground_common::normalized(c.T_map_camera);
    }
  }

  InertialBundleProblem& problem_;
  visual_frontend::BundleProblem& visual_;
  const InertialBundleSettings& settings_;
  std::vector<Keyframe> keyframe_;  // one array: Ceres orders blocks by address, the result must not depend on the heap
  std::vector<Eigen::Matrix3d> R_0_;
  std::vector<unsigned char> camera_used_, state_used_, point_used_;
  std::unique_ptr<ceres::LossFunction> loss_;
  ceres::HuberLoss link_loss_;  // one link that a spoilt sample made false may not bend the map
  ceres::Problem ceres_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_;
  int free_blocks_ = 0;
};

}  // namespace

InertialBundleResult solveInertialBundle(InertialBundleProblem& problem, const InertialBundleSettings& settings) {
  check(problem);
  const ceres::Solver::Summary summary = Solver(problem, settings).solve();
  InertialBundleResult result;
  result.usable = summary.IsSolutionUsable();
  result.message = summary.message;
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.iterations = static_cast<int>(summary.iterations.size());
  result.seconds = summary.total_time_in_seconds;
  const auto& visual = problem.visual;
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
