#include "visual_frontend/bundle_adjustment.h"

#include <ceres/crs_matrix.h>
#include <ceres/iteration_callback.h>
#include <ceres/loss_function.h>
#include <ceres/normal_prior.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>

#include "visual_frontend/ceres_costs.h"
#include "visual_frontend/inertial_costs.h"

namespace visual_frontend {

namespace {

constexpr double kBehindCamera = 1e12;
constexpr double kAnchorPosition = 1e-4;  // [m]
constexpr double kAnchorYaw = 1e-5;       // [rad]
constexpr double kLinkLossWidth = 6;      // sigmas of a whole link, of nine numbers: one in 10,000 true ones is longer
constexpr int kDenseCameras = 30;         // up to so many free ones the reduced system is solved densely
constexpr int kDenseInertial = 25;        // likewise where each has nine unknowns more
constexpr double kTolerance = 1e-5;       // relative change of the cost at which iterations end
constexpr double kCalibratedTolerance = 1e-8;  // a calibration changes it little for a long time
constexpr double kGaugeInformation = 1e-3;     // on all unknowns: a map without scale has one that nothing fixes

void check(const BundleProblem& problem) {
  const auto fail = [](const std::string& what) { throw std::invalid_argument("solveBundle: " + what); };
  const int cameras = static_cast<int>(problem.cameras.size()), points = static_cast<int>(problem.points.size());
  if (!problem.point_fixed.empty() && static_cast<int>(problem.point_fixed.size()) != points)
    fail("point_fixed must be empty or as long as points");
  for (const auto& c : problem.cameras) {
    if (!air_ground_common::isValid(c.T_map_camera)) fail("a camera pose is not finite or not a rotation");
    if (c.up_camera && !(c.up_camera->norm() > 0.5 && c.up_sigma > 0))
      fail("a gravity prior needs a unit vector and a positive sigma");
  }
  for (const auto& p : problem.points) {
    if (!p.allFinite()) fail("a point is not finite");
  }
  for (const auto& m : problem.measurements) {
    if (m.camera < 0 || m.camera >= cameras || m.point < 0 || m.point >= points)
      fail("a measurement's index is out of range");
    if (!m.normalized.allFinite() || !(m.sigma > 0) || !(m.elongation > 0))
      fail("a measurement is not finite or its sigma not positive");
    if (m.depth > 0 && !(m.depth_sigma > 0)) fail("a depth needs a positive depth_sigma");
  }
  const auto apart = [cameras](const auto& pair) {
    return pair.camera_a >= 0 && pair.camera_a < cameras && pair.camera_b >= 0 && pair.camera_b < cameras &&
           pair.camera_a != pair.camera_b;
  };
  for (const auto& p : problem.priors) {
    if (!apart(p)) fail("a prior's index is out of range");
    if (!p.sqrt_information.allFinite()) fail("a prior's information is not finite");
  }
  for (const auto& link : problem.links) {
    if (!apart(link)) fail("a link's index is out of range");
    if (!(link.motion.duration() > 0)) fail("a link without inertial samples");
  }
  if (problem.anchor >= cameras) fail("the anchor is out of range");
  if (problem.mounting && !(problem.mounting->sigma > 0 && problem.mounting->turn.allFinite()))
    fail("the standard deviation of a mounting must be positive, its turn finite");
  if (problem.calibration && !(problem.calibration->sigma.array() > 0).all())
    fail("standard deviations of a calibration must be positive");
}

/// Squared reprojection error in sigmas; kBehindCamera there.
double squaredError(const BundleProblem& problem, const BundleProblem::Measurement& m) {
  const Pose& T = problem.cameras[m.camera].T_map_camera;
  const Eigen::Vector3d p = T.linear().transpose() * (problem.points[m.point] - T.translation());
  if (!(p.z() > 1e-4)) return kBehindCamera;
  return squaredSigmas(p.head<2>() / p.z() - m.normalized, m.normalized, {m.sigma, m.elongation});
}

/// Null for RobustLoss::kNone.
std::unique_ptr<ceres::LossFunction> makeLoss(RobustLoss loss, double width) {
  switch (loss) {
    case RobustLoss::kHuber:
      return std::make_unique<ceres::HuberLoss>(width);
    case RobustLoss::kCauchy:
      return std::make_unique<ceres::CauchyLoss>(width);
    case RobustLoss::kNone:
      break;
  }
  return nullptr;
}

/// Ends the iterations once nobody wants the result any more.
class Cancellation : public ceres::IterationCallback {
 public:
  explicit Cancellation(const std::atomic<bool>* cancelled) : cancelled_(cancelled) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    return *cancelled_ ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }

 private:
  const std::atomic<bool>* cancelled_;
};

/// What is estimated of a camera.
struct Block {
  Eigen::Matrix<double, 6, 1, Eigen::DontAlign> camera;  ///< centre in the map, rotation vector from R_0
  Eigen::Vector3d velocity;
  Eigen::Matrix<double, 6, 1, Eigen::DontAlign> bias;  ///< gyro, accelerometer
};

/// A problem as Ceres takes it, and back. All blocks lie in one array: Ceres orders them by address, and the result
/// must not depend on the heap.
class Solver {
 public:
  Solver(BundleProblem& problem, const BundleSettings& settings)
      : problem_(problem),
        settings_(settings),
        block_(problem.cameras.size() + 1),
        camera_used_(problem.cameras.size(), 0),
        state_used_(problem.cameras.size(), 0),
        point_used_(problem.points.size(), 0),
        loss_(makeLoss(settings.loss, settings.loss_width)),
        depth_loss_(settings.depth_loss_width),
        link_loss_(kLinkLossWidth),
        ceres_(borrowedLosses()),
        ordering_(std::make_shared<ceres::ParameterBlockOrdering>()) {
    for (std::size_t i = 0; i < problem.cameras.size(); ++i) {
      const BundleProblem::Camera& camera = problem.cameras[i];
      block_[i].camera << camera.T_map_camera.translation(), 0, 0, 0;
      block_[i].velocity = camera.state.velocity;
      block_[i].bias << camera.state.bias.gyro, camera.state.bias.accel;
      R_0_.push_back(camera.T_map_camera.linear());
    }
    addCalibration();
    addMounting();
    addMeasurements();
    addPriors();
    addLinks();
    addCameras();
    addAnchor();
    addPoints();
  }
  Solver(const Solver&) = delete;
  Solver& operator=(const Solver&) = delete;

  /// Poses, points and states of the problem are changed where the solution is usable.
  ceres::Solver::Summary solve() {
    ceres::Solver::Options options;
    options.linear_solver_ordering = ordering_;
    options.linear_solver_type = free_cameras_ <= (problem_.links.empty() ? kDenseCameras : kDenseInertial)
                                     ? ceres::DENSE_SCHUR
                                     : ceres::SPARSE_SCHUR;
    options.max_num_iterations = settings_.max_iterations;
    options.max_solver_time_in_seconds = settings_.max_seconds;
    options.num_threads = settings_.threads;
    options.function_tolerance = problem_.calibration ? kCalibratedTolerance : kTolerance;
    options.parameter_tolerance = settings_.parameter_tolerance;
    options.logging_type = ceres::SILENT;
    Cancellation cancellation(settings_.cancelled.get());
    if (settings_.cancelled) options.callbacks.push_back(&cancellation);
    ceres::Solver::Summary summary;
    ceres::Solve(options, &ceres_, &summary);
    if (summary.IsSolutionUsable()) writeBack();
    return summary;
  }

 private:
  static ceres::Problem::Options borrowedLosses() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }

  void writeBack() {
    writeBackCalibration();
    if (problem_.mounting) problem_.mounting->turn = Eigen::Map<const Eigen::Vector3d>(mounting());
    for (std::size_t i = 0; i < problem_.cameras.size(); ++i) {
      BundleProblem::Camera& c = problem_.cameras[i];
      const Block& b = block_[i];
      if (state_used_[i] && !c.state_fixed) c.state = {b.velocity, {b.bias.head<3>(), b.bias.tail<3>()}};
      if (c.fixed || !camera_used_[i]) continue;
      c.T_map_camera.translation() = b.camera.head<3>();
      c.T_map_camera.linear() = expSO3(b.camera.tail<3>()) * R_0_[i];
      c.T_map_camera = air_ground_common::normalized(c.T_map_camera);
    }
  }

  /// Beside the cameras', whose array has one block more for it.
  double* calibration() { return block_.back().camera.data(); }

  void addCalibration() {
    if (!problem_.calibration) return;
    const CalibrationEstimate& estimate = *problem_.calibration;
    Eigen::Map<CalibrationVector>(calibration()).setZero();
    ceres_.AddResidualBlock(
        new ceres::NormalPrior(Eigen::MatrixXd(estimate.sigma.cwiseInverse().asDiagonal()), estimate.mean), nullptr,
        calibration());
    ordering_->AddElementToGroup(calibration(), 1);
  }

  /// Likewise.
  double* mounting() { return block_.back().velocity.data(); }

  void addMounting() {
    Eigen::Map<Eigen::Vector3d> turn(mounting());
    turn.setZero();
    if (!problem_.metric || problem_.links.empty()) return;
    ceres_.AddParameterBlock(mounting(), 3);
    ordering_->AddElementToGroup(mounting(), 1);
    if (!problem_.mounting) return ceres_.SetParameterBlockConstant(mounting());
    const BundleProblem::Mounting& open = *problem_.mounting;
    turn = open.turn;
    ceres_.AddResidualBlock(
        new ceres::NormalPrior(Eigen::MatrixXd(Eigen::Matrix3d::Identity() / open.sigma), open.mean), nullptr,
        mounting());
  }

  void writeBackCalibration() {
    if (!problem_.calibration) return;
    problem_.calibration->error = Eigen::Map<const CalibrationVector>(calibration());
    problem_.calibration->covariance = calibrationCovariance();
    for (auto& m : problem_.measurements) m.normalized += m.by_calibration * problem_.calibration->error;
  }

  /// What the images leave open of the calibration when poses, points and states are free.
  CalibrationMatrix calibrationCovariance() {
    ceres::Problem::EvaluateOptions options;
    ceres_.GetParameterBlocks(&options.parameter_blocks);
    auto& blocks = options.parameter_blocks;
    blocks.erase(std::remove_if(blocks.begin(), blocks.end(),
                                [this](double* b) { return b == calibration() || ceres_.IsParameterBlockConstant(b); }),
                 blocks.end());
    blocks.insert(blocks.begin(), calibration());
    ceres::CRSMatrix crs;
    ceres_.Evaluate(options, nullptr, nullptr, nullptr, &crs);
    const Eigen::Map<const Eigen::SparseMatrix<double, Eigen::RowMajor>> J(
        crs.num_rows, crs.num_cols, static_cast<Eigen::Index>(crs.values.size()), crs.rows.data(), crs.cols.data(),
        crs.values.data());
    Eigen::SparseMatrix<double> H = Eigen::SparseMatrix<double>(J.transpose()) * J;
    for (Eigen::Index i = 0; i < H.cols(); ++i) H.coeffRef(i, i) += kGaugeInformation;
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(H);
    const Eigen::MatrixXd columns = solver.solve(Eigen::MatrixXd::Identity(H.cols(), kCalibrationStates));
    return columns.topRows<kCalibrationStates>();
  }

  void addMeasurements() {
    for (const auto& m : problem_.measurements) {
      // A point behind its camera at the start has no gradient that helps: it is reported as an outlier.
      if (squaredError(problem_, m) >= kBehindCamera) continue;
      double *camera = block_[m.camera].camera.data(), *point = problem_.points[m.point].data();
      const NormalizedNoise noise{m.sigma, m.elongation};
      if (problem_.calibration)
        ceres_.AddResidualBlock(new CalibratedReprojectionCost(R_0_[m.camera], m.normalized, noise, m.by_calibration),
                                loss_.get(), camera, point, calibration());
      else
        ceres_.AddResidualBlock(new ReprojectionCost(R_0_[m.camera], m.normalized, noise), loss_.get(), camera, point);
      if (settings_.use_depth && m.depth > 0)
        ceres_.AddResidualBlock(new DepthCost(R_0_[m.camera], m.depth, m.depth_sigma), &depth_loss_, camera, point);
      camera_used_[m.camera] = point_used_[m.point] = 1;
    }
  }

  void addPriors() {
    for (const auto& p : problem_.priors) {
      ceres_.AddResidualBlock(new RelativePoseCost<6>(R_0_[p.camera_a], R_0_[p.camera_b], p.T_a_b, p.sqrt_information),
                              p.may_be_false ? &link_loss_ : nullptr, block_[p.camera_a].camera.data(),
                              block_[p.camera_b].camera.data());
      camera_used_[p.camera_a] = camera_used_[p.camera_b] = 1;
    }
  }

  void addLinks() {
    for (const auto& link : problem_.links) {
      Block &a = block_[link.camera_a], &b = block_[link.camera_b];
      const Eigen::Matrix3d &R_a = R_0_[link.camera_a], &R_b = R_0_[link.camera_b];
      if (problem_.metric) {
        ceres_.AddResidualBlock(new InertialCost(R_a, R_b, problem_.T_camera_imu, link.motion), &link_loss_,
                                a.camera.data(), a.velocity.data(), a.bias.data(), b.camera.data(), b.velocity.data(),
                                mounting());
      } else {
        ceres_.AddResidualBlock(new GyroCost(R_a, R_b, problem_.T_camera_imu.linear(), link.motion), &link_loss_,
                                a.camera.data(), a.bias.data(), b.camera.data());
      }
      const double root_dt = std::sqrt(link.motion.duration());
      const ImuNoise& noise = link.motion.noise();
      ceres_.AddResidualBlock(new BiasWalkCost(noise.gyro_bias_walk * root_dt, noise.accel_bias_walk * root_dt),
                              nullptr, a.bias.data(), b.bias.data());
      for (const int i : {link.camera_a, link.camera_b}) camera_used_[i] = state_used_[i] = 1;
    }
  }

  void addCameras() {
    std::vector<unsigned char> has_predecessor(problem_.cameras.size(), 0);
    for (const auto& link : problem_.links) has_predecessor[link.camera_b] = 1;
    for (std::size_t i = 0; i < problem_.cameras.size(); ++i) {
      addGravity(i);
      if (!camera_used_[i]) continue;
      ordering_->AddElementToGroup(block_[i].camera.data(), 1);
      if (problem_.cameras[i].fixed)
        ceres_.SetParameterBlockConstant(block_[i].camera.data());
      else
        ++free_cameras_;
      if (state_used_[i]) addState(i, has_predecessor[i]);
    }
  }

  void addGravity(std::size_t i) {
    const BundleProblem::Camera& c = problem_.cameras[i];
    if (!settings_.use_gravity || !c.up_camera || c.fixed) return;
    ceres_.AddResidualBlock(new GravityCost(R_0_[i], *c.up_camera, c.up_sigma), nullptr, block_[i].camera.data());
    camera_used_[i] = 1;
  }

  void addState(std::size_t i, bool has_predecessor) {
    Block& b = block_[i];
    if (problem_.metric) ordering_->AddElementToGroup(b.velocity.data(), 1);
    ordering_->AddElementToGroup(b.bias.data(), 1);
    if (problem_.cameras[i].state_fixed) {
      if (problem_.metric) ceres_.SetParameterBlockConstant(b.velocity.data());
      ceres_.SetParameterBlockConstant(b.bias.data());
    } else if (!has_predecessor) {
      // Where a chain of links begins, nothing else says what the bias was before.
      Vector6d sigma, mean = b.bias;
      sigma << Eigen::Vector3d::Constant(settings_.gyro_bias_prior),
          Eigen::Vector3d::Constant(settings_.accel_bias_prior);
      if (settings_.gyro_bias_mean) mean.head<3>() = *settings_.gyro_bias_mean;
      ceres_.AddResidualBlock(new PriorCost(mean, sigma), nullptr, b.bias.data());
    }
  }

  void addAnchor() {
    if (problem_.anchor < 0 || !camera_used_[problem_.anchor]) return;
    auto& camera = block_[problem_.anchor].camera;
    Vector6d sigma;
    sigma << Eigen::Vector3d::Constant(kAnchorPosition), 0, 0, kAnchorYaw;
    ceres_.AddResidualBlock(new PriorCost(camera, sigma), nullptr, camera.data());
  }

  void addPoints() {
    for (std::size_t i = 0; i < problem_.points.size(); ++i) {
      if (!point_used_[i]) continue;
      ordering_->AddElementToGroup(problem_.points[i].data(), 0);
      if (!problem_.point_fixed.empty() && problem_.point_fixed[i])
        ceres_.SetParameterBlockConstant(problem_.points[i].data());
    }
  }

  BundleProblem& problem_;
  const BundleSettings& settings_;
  std::vector<Block> block_;
  std::vector<Eigen::Matrix3d> R_0_;
  std::vector<unsigned char> camera_used_, state_used_, point_used_;
  std::unique_ptr<ceres::LossFunction> loss_;
  ceres::CauchyLoss depth_loss_;
  ceres::HuberLoss link_loss_;  // one link that a spoilt sample made false may not bend the map
  ceres::Problem ceres_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_;
  int free_cameras_ = 0;
};

/// The solver's words, and of the solved problem the measurements beyond `outlier_threshold` [sigmas].
BundleResult bundleResult(const ceres::Solver::Summary& summary, const BundleProblem& problem,
                          double outlier_threshold) {
  BundleResult result;
  result.usable = summary.IsSolutionUsable();
  result.message = summary.message;
  result.initial_cost = summary.initial_cost;
  result.final_cost = summary.final_cost;
  result.iterations = static_cast<int>(summary.iterations.size());
  result.seconds = summary.total_time_in_seconds;
  double sum = 0;
  std::size_t inliers = 0;
  for (std::size_t i = 0; i < problem.measurements.size(); ++i) {
    const double e2 = squaredError(problem, problem.measurements[i]);
    if (e2 > outlier_threshold * outlier_threshold) {
      result.outliers.push_back(static_cast<int>(i));
    } else {
      sum += e2;
      ++inliers;
    }
  }
  result.rms = inliers > 0 ? std::sqrt(sum / (2.0 * static_cast<double>(inliers))) : 0;
  return result;
}

}  // namespace

Matrix6d sqrtRotationInformation(double sigma) {
  Matrix6d root = Matrix6d::Zero();
  root.diagonal().tail<3>().setConstant(1 / sigma);
  return root;
}

BundleResult solveBundle(BundleProblem& problem, const BundleSettings& settings) {
  check(problem);
  const ceres::Solver::Summary summary = Solver(problem, settings).solve();
  return bundleResult(summary, problem, settings.outlier_threshold);
}

}  // namespace visual_frontend
