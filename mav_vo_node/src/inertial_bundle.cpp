#include "mav_vo/inertial_bundle.h"

#include <cmath>
#include <memory>
#include <stdexcept>

#include "inertial_costs.h"
#include "visual_frontend/bundle_solver.h"

namespace mav_vo {

namespace {

using Vector6d = air_ground_common::Vector6d;
using visual_frontend::BundleProblem;

constexpr double kAnchorPosition = 1e-4;  // [m]
constexpr double kAnchorYaw = 1e-5;       // [rad]
constexpr double kParameterTolerance = 1e-8;
constexpr int kDenseCameras = 25;     // each has nine unknowns more
constexpr double kLinkLossWidth = 6;  // sigmas of a whole link, of nine numbers: one in 10,000 true ones is longer

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

struct Keyframe {
  Eigen::Matrix<double, 6, 1, Eigen::DontAlign> camera = Vector6d::Zero();  ///< centre, rotation vector from R_0
  Eigen::Vector3d velocity;
  Eigen::Matrix<double, 6, 1, Eigen::DontAlign> bias;  ///< gyro, accelerometer
};

class Solver : visual_frontend::BundleSolver<Keyframe> {
 public:
  Solver(InertialBundleProblem& problem, const InertialBundleSettings& settings)
      : BundleSolver(problem.visual, settings.loss, settings.loss_width),
        inertial_(problem),
        settings_(settings),
        state_used_(block_.size(), 0),
        link_loss_(kLinkLossWidth) {
    for (std::size_t i = 0; i < block_.size(); ++i) {
      block_[i].velocity = problem.states[i].velocity;
      block_[i].bias << problem.states[i].bias.gyro, problem.states[i].bias.accel;
    }
    addMeasurements([](const BundleProblem::Measurement&) {});
    addLinks();
    addCameras();
    addAnchor();
    addPoints();
  }

  ceres::Solver::Summary solve() {
    const auto summary = BundleSolver::solve(
        {settings_.max_iterations, settings_.max_seconds, settings_.threads, kParameterTolerance, kDenseCameras});
    if (!summary.IsSolutionUsable()) return summary;
    for (std::size_t i = 0; i < block_.size(); ++i)
      if (state_used_[i] && !inertial_.state_fixed[i])
        inertial_.states[i] = {block_[i].velocity, {block_[i].bias.head<3>(), block_[i].bias.tail<3>()}};
    return summary;
  }

 private:
  void addLinks() {
    for (const auto& link : inertial_.links) {
      Keyframe &a = block_[link.a], &b = block_[link.b];
      if (inertial_.metric) {
        ceres_.AddResidualBlock(new InertialCost(R_0_[link.a], R_0_[link.b], inertial_.T_camera_imu, link.motion),
                                &link_loss_, a.camera.data(), a.velocity.data(), a.bias.data(), b.camera.data(),
                                b.velocity.data());
      } else {
        ceres_.AddResidualBlock(new GyroCost(R_0_[link.a], R_0_[link.b], inertial_.T_camera_imu.linear(), link.motion),
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
    std::vector<unsigned char> has_predecessor(block_.size(), 0);
    for (const auto& link : inertial_.links) has_predecessor[link.b] = 1;
    for (std::size_t i = 0; i < block_.size(); ++i) {
      if (!camera_used_[i]) continue;
      addCamera(i);
      addGravity(i);
      if (state_used_[i]) addState(i, has_predecessor[i]);
    }
  }

  void addState(std::size_t i, bool has_predecessor) {
    Keyframe& k = block_[i];
    if (inertial_.metric) ordering_->AddElementToGroup(k.velocity.data(), 1);
    ordering_->AddElementToGroup(k.bias.data(), 1);
    if (inertial_.state_fixed[i]) {
      if (inertial_.metric) ceres_.SetParameterBlockConstant(k.velocity.data());
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
    if (inertial_.anchor < 0 || !camera_used_[inertial_.anchor]) return;
    auto& camera = block_[inertial_.anchor].camera;
    Vector6d sigma;
    sigma << Eigen::Vector3d::Constant(kAnchorPosition), 0, 0, kAnchorYaw;
    ceres_.AddResidualBlock(new PriorCost(camera, sigma), nullptr, camera.data());
  }

  InertialBundleProblem& inertial_;
  const InertialBundleSettings& settings_;
  std::vector<unsigned char> state_used_;
  ceres::HuberLoss link_loss_;  // one link that a spoilt sample made false may not bend the map
};

}  // namespace

InertialBundleResult solveInertialBundle(InertialBundleProblem& problem, const InertialBundleSettings& settings) {
  check(problem);
  const ceres::Solver::Summary summary = Solver(problem, settings).solve();
  return visual_frontend::bundleResult(summary, problem.visual, settings.outlier_threshold);
}

}  // namespace mav_vo
