// What every bundle adjustment on Ceres shares: cameras, points, reprojection errors. For those who add their own
// costs.
#pragma once

#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <memory>
#include <vector>

#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/ceres_costs.h"

namespace visual_frontend {

/// Squared reprojection error in sigmas; kBehindCamera there.
double squaredError(const BundleProblem& problem, const BundleProblem::Measurement& m);
constexpr double kBehindCamera = 1e12;

/// Null for RobustLoss::kNone.
std::unique_ptr<ceres::LossFunction> makeLoss(RobustLoss loss, double width);

/// The solver's words, and of the solved problem the measurements beyond `outlier_threshold` [sigmas].
BundleResult bundleResult(const ceres::Solver::Summary& summary, const BundleProblem& problem,
                          double outlier_threshold);

struct SolverLimits {
  int iterations = 10;
  double seconds = 1;  ///< wall clock
  int threads = 1;
  double parameter_tolerance = 1e-7;
  int dense_cameras = 30;  ///< up to so many free ones the reduced system is solved densely
};

/// A problem as Ceres takes it, and back. `Block`: what is estimated of a camera; begins with `camera`, its centre in
/// the map and the rotation vector from its first orientation. All blocks lie in one array: Ceres orders them by
/// address, and the result must not depend on the heap.
template <typename Block>
class BundleSolver {
 public:
  BundleSolver(const BundleSolver&) = delete;
  BundleSolver& operator=(const BundleSolver&) = delete;

 protected:
  BundleSolver(BundleProblem& problem, RobustLoss loss, double loss_width)
      : problem_(problem),
        block_(problem.cameras.size()),
        camera_used_(problem.cameras.size(), 0),
        point_used_(problem.points.size(), 0),
        loss_(makeLoss(loss, loss_width)),
        ceres_(borrowedLosses()),
        ordering_(std::make_shared<ceres::ParameterBlockOrdering>()) {
    for (std::size_t i = 0; i < block_.size(); ++i) {
      block_[i].camera << problem.cameras[i].T_map_camera.translation(), 0, 0, 0;
      R_0_.push_back(problem.cameras[i].T_map_camera.linear());
    }
  }
  ~BundleSolver() = default;

  /// `also`: called with each measurement whose reprojection error was added.
  template <typename Also>
  void addMeasurements(const Also& also) {
    for (const auto& m : problem_.measurements) {
      // A point behind its camera at the start has no gradient that helps: it is reported as an outlier.
      if (squaredError(problem_, m) >= kBehindCamera) continue;
      ceres_.AddResidualBlock(new ReprojectionCost(R_0_[m.camera], m.normalized, {m.sigma, m.elongation}), loss_.get(),
                              block_[m.camera].camera.data(), problem_.points[m.point].data());
      also(m);
      camera_used_[m.camera] = point_used_[m.point] = 1;
    }
  }

  void addGravity(std::size_t i) {
    const auto& c = problem_.cameras[i];
    if (c.up_camera && !c.fixed)
      ceres_.AddResidualBlock(new GravityCost(R_0_[i], *c.up_camera, c.up_sigma), nullptr, block_[i].camera.data());
  }

  void addCamera(std::size_t i) {
    ordering_->AddElementToGroup(block_[i].camera.data(), 1);
    if (problem_.cameras[i].fixed)
      ceres_.SetParameterBlockConstant(block_[i].camera.data());
    else
      ++free_cameras_;
  }

  void addPoints() {
    for (std::size_t i = 0; i < problem_.points.size(); ++i) {
      if (!point_used_[i]) continue;
      ordering_->AddElementToGroup(problem_.points[i].data(), 0);
      if (!problem_.point_fixed.empty() && problem_.point_fixed[i])
        ceres_.SetParameterBlockConstant(problem_.points[i].data());
    }
  }

  /// Poses and points of the problem are changed where the solution is usable.
  ceres::Solver::Summary solve(const SolverLimits& limits) {
    ceres::Solver::Options options;
    options.linear_solver_ordering = ordering_;
    options.linear_solver_type = free_cameras_ <= limits.dense_cameras ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
    options.max_num_iterations = limits.iterations;
    options.max_solver_time_in_seconds = limits.seconds;
    options.num_threads = limits.threads;
    options.function_tolerance = 1e-5;
    options.parameter_tolerance = limits.parameter_tolerance;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &ceres_, &summary);
    if (!summary.IsSolutionUsable()) return summary;
    for (std::size_t i = 0; i < block_.size(); ++i) {
      auto& c = problem_.cameras[i];
      if (c.fixed || !camera_used_[i]) continue;
      c.T_map_camera.translation() = block_[i].camera.template head<3>();
      c.T_map_camera.linear() = air_ground_common::expSO3(block_[i].camera.template tail<3>()) * R_0_[i];
      c.T_map_camera = air_ground_common::normalized(c.T_map_camera);
    }
    return summary;
  }

  BundleProblem& problem_;
  std::vector<Block> block_;
  std::vector<Eigen::Matrix3d> R_0_;
  std::vector<unsigned char> camera_used_, point_used_;
  std::unique_ptr<ceres::LossFunction> loss_;
  ceres::Problem ceres_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_;
  int free_cameras_ = 0;

 private:
  static ceres::Problem::Options borrowedLosses() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }
};

}  // namespace visual_frontend
