#include <gtest/gtest.h>

#include "synthetic_flight.h"
#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/inertial_costs.h"

using namespace visual_frontend;
using air_ground_common::Pose;

namespace {

/// Numeric derivative of a cost function against its analytic Jacobians.
template <int Residuals, std::size_t Blocks>
void checkJacobians(const ceres::CostFunction& cost, const std::array<std::vector<double>, Blocks>& x0,
                    double tolerance) {
  std::array<std::vector<double>, Blocks> x = x0, jacobian;
  std::array<const double*, Blocks> pointers;
  std::array<double*, Blocks> jacobian_pointers;
  for (std::size_t b = 0; b < Blocks; ++b) {
    pointers[b] = x[b].data();
    jacobian[b].resize(Residuals * x[b].size());
    jacobian_pointers[b] = jacobian[b].data();
  }
  std::vector<double> r(Residuals), plus(Residuals), minus(Residuals);
  ASSERT_TRUE(cost.Evaluate(pointers.data(), r.data(), jacobian_pointers.data()));
  for (std::size_t b = 0; b < Blocks; ++b) {
    for (std::size_t k = 0; k < x[b].size(); ++k) {
      const double h = 1e-6, kept = x[b][k];
      x[b][k] = kept + h;
      cost.Evaluate(pointers.data(), plus.data(), nullptr);
      x[b][k] = kept - h;
      cost.Evaluate(pointers.data(), minus.data(), nullptr);
      x[b][k] = kept;
      double scale = 1, error = 0;
      for (int i = 0; i < Residuals; ++i) {
        const double numeric = (plus[i] - minus[i]) / (2 * h);
        scale = std::max(scale, std::abs(numeric));
        error = std::max(error, std::abs(numeric - jacobian[b][i * x[b].size() + k]));
      }
      EXPECT_LT(error, tolerance * scale) << "block " << b << " parameter " << k;
    }
  }
}

Preintegration motionBetween(double t0, double t1, const ImuNoise& noise, const ImuBias& bias, const ImuBias& at,
                             std::mt19937& random) {
  Preintegration motion(noise, at);
  motion.integrate(synthetic::Flight{}.imuSamples(t0, t1, 200, noise, bias, random));
  return motion;
}

TEST(InertialCost, VanishesAtTheTruth) {
  const synthetic::Flight flight;
  std::mt19937 random(1);
  const double t0 = 4.0, t1 = 4.5;
  const ImuNoise tiny{1e-9, 1e-9, 1e-9, 1e-9};
  const ImuBias bias{{0.01, -0.02, 0.005}, {0.05, 0.1, -0.1}};
  const Preintegration motion = motionBetween(t0, t1, tiny, bias, bias, random);
  // Weighed with realistic noise: residuals in sigmas.
  Preintegration realistic(ImuNoise{}, bias);
  realistic.integrate(motion.samples());
  const Pose a = flight.T_world_imu(t0) * synthetic::T_imu_camera(),
             b = flight.T_world_imu(t1) * synthetic::T_imu_camera();
  const InertialCost cost(a.linear(), b.linear(), synthetic::T_imu_camera().inverse(), realistic);
  std::vector<double> ca(6, 0.0), cb(6, 0.0), bias_vector(6);
  Eigen::Map<Eigen::Vector3d>(ca.data()) = a.translation();
  Eigen::Map<Eigen::Vector3d>(cb.data()) = b.translation();
  Eigen::Map<Eigen::Vector3d>(bias_vector.data()) = bias.gyro;
  Eigen::Map<Eigen::Vector3d>(bias_vector.data() + 3) = bias.accel;
  const Eigen::Vector3d va = flight.velocity(t0), vb = flight.velocity(t1);
  const Eigen::Vector3d as_given = Eigen::Vector3d::Zero();
  const double* x[] = {ca.data(), va.data(), bias_vector.data(), cb.data(), vb.data(), as_given.data()};
  Eigen::Matrix<double, 9, 1> r;
  ASSERT_TRUE(cost.Evaluate(x, r.data(), nullptr));
  EXPECT_LT(r.norm(), 0.3);
}

TEST(InertialCost, JacobiansMatchNumericDerivatives) {
  const synthetic::Flight flight;
  std::mt19937 random(2);
  const Preintegration motion = motionBetween(4.0, 4.4, ImuNoise{}, ImuBias{}, ImuBias{}, random);
  const Pose a = flight.T_world_imu(4.0) * synthetic::T_imu_camera(),
             b = flight.T_world_imu(4.4) * synthetic::T_imu_camera();
  const InertialCost cost(a.linear(), b.linear(), synthetic::T_imu_camera().inverse(), motion);
  const auto vector = [&](int n, double scale) {
    std::normal_distribution<double> normal(0, scale);
    std::vector<double> v(n);
    for (double& e : v) e = normal(random);
    return v;
  };
  checkJacobians<9, 6>(
      cost, {vector(6, 0.05), vector(3, 1.0), vector(6, 1e-4), vector(6, 0.05), vector(3, 1.0), vector(3, 0.1)}, 2e-3);
}

TEST(GyroCost, JacobiansMatchNumericDerivatives) {
  const synthetic::Flight flight;
  std::mt19937 random(3);
  const Preintegration motion = motionBetween(4.0, 4.4, ImuNoise{}, ImuBias{}, ImuBias{}, random);
  const Pose a = flight.T_world_imu(4.0) * synthetic::T_imu_camera(),
             b = flight.T_world_imu(4.4) * synthetic::T_imu_camera();
  const GyroCost cost(a.linear(), b.linear(), synthetic::T_imu_camera().inverse().linear(), motion);
  checkJacobians<3, 3>(
      cost,
      {std::vector<double>{1, 2, 3, 0.01, -0.02, 0.03}, std::vector<double>{1e-4, -2e-4, 1e-4, 0.1, 0.2, 0.3},
       std::vector<double>{1, 2, 3, -0.02, 0.01, 0.01}},
      2e-3);
}

TEST(BiasAndPriorCost, JacobiansMatchNumericDerivatives) {
  checkJacobians<6, 2>(BiasWalkCost(1e-3, 1e-2), {std::vector<double>(6, 0.1), std::vector<double>(6, 0.2)}, 1e-6);
  PriorCost::Vector sigma;
  sigma << 1, 2, 0, 0, 1, 1e-3;
  checkJacobians<6, 1>(PriorCost(PriorCost::Vector::Ones(), sigma), {std::vector<double>(6, 0.1)}, 1e-6);
}

struct World {
  BundleProblem problem;
  std::vector<Pose> truth;
};

/// Keyframes, two a second, with noisy images and IMU; the map starts `scale` times too large and tilted.
World makeWorld(double scale, double tilt, unsigned seed, int count = 400, int keyframes = 12) {
  const synthetic::Flight flight;
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const auto points = synthetic::pointCloud(count, random);
  const auto camera = synthetic::camera();
  const double sigma = 0.5 / camera.fx, begin = 2.2, step = 0.5;
  const ImuNoise noise;
  const ImuBias bias{{2e-3, -1e-3, 1e-3}, {0.04, -0.06, 0.03}};
  World world;
  auto& p = world.problem;
  const Eigen::Matrix3d R = air_ground_common::expSO3({tilt, -tilt, 0});
  const Pose first = flight.T_world_imu(begin) * synthetic::T_imu_camera();
  p.points = points;
  p.T_camera_imu = synthetic::T_imu_camera().inverse();
  p.anchor = 0;
  for (int k = 0; k < keyframes; ++k) {
    const double t = begin + k * step;
    const Pose T = flight.T_world_imu(t) * synthetic::T_imu_camera();
    world.truth.push_back(T);
    for (int i = 0; i < static_cast<int>(points.size()); ++i) {
      const Eigen::Vector3d q = T.inverse() * points[i];
      const auto pixel = camera.project(q);
      if (!pixel || !camera.contains(*pixel)) continue;
      p.measurements.push_back(
          {k, i, q.head<2>() / q.z() + sigma * Eigen::Vector2d(normal(random), normal(random)), sigma, 0, 0});
    }
    BundleProblem::Camera c;
    c.T_map_camera.linear() = R * T.linear();
    c.T_map_camera.translation() = first.translation() + scale * (R * (T.translation() - first.translation()));
    c.state.velocity = flight.velocity(t) + 0.1 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    p.cameras.push_back(c);
    if (k > 0) p.links.push_back({k - 1, k, motionBetween(t - step, t, noise, bias, ImuBias{}, random)});
  }
  for (auto& point : p.points) point = first.translation() + scale * (R * (point - first.translation()));
  return world;
}

TEST(InertialBundle, FindsScaleAndGravity) {
  for (const double scale : {0.85, 1.0, 1.2}) {
    World world = makeWorld(scale, 0.02, 5);
    BundleSettings settings;
    settings.max_iterations = 30;
    const auto result = solveBundle(world.problem, settings);
    ASSERT_TRUE(result.usable) << result.message;
    double length = 0, truth = 0, tilt = 0;
    for (std::size_t k = 1; k < world.truth.size(); ++k) {
      length += (world.problem.cameras[k].T_map_camera.translation() -
                 world.problem.cameras[k - 1].T_map_camera.translation())
                    .norm();
      truth += (world.truth[k].translation() - world.truth[k - 1].translation()).norm();
      const Eigen::Vector3d up = world.problem.cameras[k].T_map_camera.linear().row(2),
                            up_truth = world.truth[k].linear().row(2);
      tilt = std::max(tilt, std::acos(std::min(1.0, up.dot(up_truth))));
    }
    EXPECT_NEAR(length / truth, 1.0, 0.01) << "started at scale " << scale;
    EXPECT_LT(tilt, 0.006);
    // One sigma less what the fit of points and poses takes up.
    EXPECT_GT(result.rms, 0.6);
    EXPECT_LT(result.rms, 1.0);
    EXPECT_LT((world.problem.cameras[0].T_map_camera.translation() - world.truth[0].translation()).norm(), 1e-3);
    EXPECT_LT((world.problem.cameras.back().state.bias.accel - Eigen::Vector3d(0.04, -0.06, 0.03)).norm(), 0.05);
    EXPECT_LT((world.problem.cameras.back().state.bias.gyro - Eigen::Vector3d(2e-3, -1e-3, 1e-3)).norm(), 1e-3);
  }
}

// The axes that the problem is given are turned by half a degree against those that the IMU has.
TEST(InertialBundle, FindsHowTheImuIsTurned) {
  for (const Eigen::Vector3d turn : {Eigen::Vector3d(0.006, -0.004, 0.005), Eigen::Vector3d(0, 0, 0)}) {
    double cost_held = 0;
    for (const bool estimated : {false, true}) {
      World world = makeWorld(1.0, 0.0, 9, 4000, 40);
      auto& T_camera_imu = world.problem.T_camera_imu;
      T_camera_imu.linear() = T_camera_imu.linear() * air_ground_common::expSO3(turn).transpose();
      if (estimated) world.problem.mounting = BundleProblem::Mounting{};
      BundleSettings settings;
      settings.max_iterations = 40;
      const auto result = solveBundle(world.problem, settings);
      ASSERT_TRUE(result.usable);
      if (!estimated) {
        cost_held = result.final_cost;
        continue;
      }
      EXPECT_LT((world.problem.mounting->turn - turn).norm(), 0.0035) << world.problem.mounting->turn.transpose();
      // Three numbers explain what half a degree makes the links contradict the images by, and little where nothing
      // does.
      if (turn.isZero())
        EXPECT_NEAR(result.final_cost, cost_held, 10);
      else
        EXPECT_LT(result.final_cost, cost_held - 20);
    }
  }
}

TEST(InertialBundle, WithoutMetresTheGyroStillBindsRotations) {
  const auto solve = [](World& world, const BundleSettings& settings) {
    world.problem.metric = false;
    world.problem.cameras[0].fixed = true;
    EXPECT_TRUE(solveBundle(world.problem, settings).usable);
    double worst = 0;
    for (std::size_t k = 0; k < world.truth.size(); ++k)
      worst = std::max(worst, air_ground_common::rotationAngle(world.problem.cameras[k].T_map_camera.linear(),
                                                               world.truth[k].linear()));
    return worst;
  };
  const Eigen::Vector3d gyro_bias(2e-3, -1e-3, 1e-3);
  World seen = makeWorld(1.0, 0.0, 8);
  BundleSettings patient;
  patient.max_iterations = 40;
  // Some 15 points an image show the bias to a fraction of its prior (0.01 rad/s); 5.5 s of its error is what the
  // rotation may be off.
  EXPECT_LT(solve(seen, patient), 0.012);
  EXPECT_LT((seen.problem.cameras.back().state.bias.gyro - gyro_bias).norm(), 2e-3);

  // So few points that images alone leave the rotation loose, but the bias known from a rest.
  World sparse = makeWorld(1.0, 0.0, 8);
  auto& measurements = sparse.problem.measurements;
  measurements.erase(
      std::remove_if(measurements.begin(), measurements.end(), [](const auto& m) { return m.point > 60; }),
      measurements.end());
  for (auto& camera : sparse.problem.cameras) camera.state.bias.gyro = gyro_bias;
  BundleSettings settings;
  settings.gyro_bias_prior = 1e-4;
  EXPECT_LT(solve(sparse, settings), 0.004);
}

TEST(InertialBundle, ReportsOutliers) {
  World world = makeWorld(1.0, 0.0, 6);
  world.problem.measurements[10].normalized.x() += 0.1;
  const auto result = solveBundle(world.problem, BundleSettings{});
  EXPECT_NE(std::find(result.outliers.begin(), result.outliers.end(), 10), result.outliers.end());
}

TEST(InertialBundle, RejectsIndicesOutOfRange) {
  World world = makeWorld(1.0, 0.0, 6);
  world.problem.links[0].camera_b = 99;
  EXPECT_THROW(solveBundle(world.problem, BundleSettings{}), std::invalid_argument);
  world = makeWorld(1.0, 0.0, 6);
  world.problem.anchor = 12;
  EXPECT_THROW(solveBundle(world.problem, BundleSettings{}), std::invalid_argument);
}

}  // namespace
