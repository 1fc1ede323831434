#include <gtest/gtest.h>

#include "air_ground_common/linear_algebra.h"

#include "synthetic.h"
#include "visual_frontend/bundle_job.h"
#include "visual_frontend/ceres_costs.h"
#include "visual_frontend/pose_graph.h"

namespace visual_frontend {
namespace {

using synthetic::Random;

/// Largest difference between a cost's Jacobians and central differences, relative to the Jacobian's size.
double jacobianError(const ceres::CostFunction& cost, std::vector<std::vector<double>> x) {
  const int rows = cost.num_residuals();
  std::vector<const double*> parameters;
  for (auto& block : x) parameters.push_back(block.data());
  std::vector<std::vector<double>> analytic;
  std::vector<double*> jacobians;
  for (const auto& block : x) analytic.emplace_back(rows * block.size());
  for (auto& a : analytic) jacobians.push_back(a.data());
  std::vector<double> r(rows), plus(rows), minus(rows);
  EXPECT_TRUE(cost.Evaluate(parameters.data(), r.data(), jacobians.data()));
  double worst = 0, size = 1e-9;
  for (std::size_t b = 0; b < x.size(); ++b) {
    for (std::size_t k = 0; k < x[b].size(); ++k) {
      const double keep = x[b][k], h = 1e-6;
      x[b][k] = keep + h;
      cost.Evaluate(parameters.data(), plus.data(), nullptr);
      x[b][k] = keep - h;
      cost.Evaluate(parameters.data(), minus.data(), nullptr);
      x[b][k] = keep;
      for (int i = 0; i < rows; ++i) {
        const double numeric = (plus[i] - minus[i]) / (2 * h);
        worst = std::max(worst, std::abs(numeric - analytic[b][i * x[b].size() + k]));
        size = std::max(size, std::abs(numeric));
      }
    }
  }
  return worst / size;
}

std::vector<double> vectorOf(const Eigen::VectorXd& v) { return {v.data(), v.data() + v.size()}; }

TEST(Jacobians, MatchDifferences) {
  Random random(1);
  for (int i = 0; i < 50; ++i) {
    const Pose T = synthetic::randomPose(random);
    // The present rotation is exp(theta) R_0: away from theta = 0 too.
    const Eigen::Vector3d theta = random.vector(i < 10 ? 0 : 0.5);
    const Eigen::Matrix3d R_0 = expSO3(-theta) * T.linear();
    Vector6d camera;
    camera << T.translation(), theta;
    const Eigen::Vector3d p = synthetic::visiblePoint(random, T);
    EXPECT_LT(
        jacobianError(ReprojectionCost(R_0, {0.1, -0.2}, {0.002, i % 2 ? 3.0 : 1.0}), {vectorOf(camera), vectorOf(p)}),
        1e-6);
    RayByCalibration by_calibration;
    by_calibration << random.vector(1).head<2>(), random.vector(1).head<2>();
    EXPECT_LT(jacobianError(CalibratedReprojectionCost(R_0, {0.1, -0.2}, {0.002, 3.0}, by_calibration),
                            {vectorOf(camera), vectorOf(p), {0.03, -0.02}}),
              1e-6);
    EXPECT_LT(jacobianError(DepthCost(R_0, 2.0, 0.01), {vectorOf(camera), vectorOf(p)}), 1e-6);
    EXPECT_LT(jacobianError(GravityCost(R_0, random.vector(1).normalized(), 0.01), {vectorOf(camera)}), 1e-6);

    const Pose B = synthetic::randomPose(random);
    Vector6d camera_b;
    camera_b << B.translation(), random.vector(0.5);
    const Pose T_a_b = T.inverse() * B;
    Matrix6d W = Matrix6d::Random();
    EXPECT_LT(jacobianError(RelativePoseCost<6>(R_0, B.linear(), T_a_b, W), {vectorOf(camera), vectorOf(camera_b)}),
              1e-5);
    Eigen::Vector4d a4, b4;
    a4 << T.translation(), 0.4;
    b4 << B.translation(), -0.3;
    EXPECT_LT(jacobianError(RelativePoseCost<4>(R_0, B.linear(), T_a_b, W), {vectorOf(a4), vectorOf(b4)}), 1e-5);
  }
}

/// Cameras on an arc that look at points, with noisy starts.
struct Scene {
  BundleProblem truth, problem;
};

Scene arc(unsigned seed, int cameras, int points, double pixel_noise, bool depth, double start_noise) {
  Random random(seed);
  Scene s;
  for (int i = 0; i < cameras; ++i) {
    const double angle = 0.12 * i;
    BundleProblem::Camera c;
    const Eigen::Vector3d position(3 * std::sin(angle), -3 * std::cos(angle), 0.5 + 0.05 * i);
    const Eigen::Vector3d z = (Eigen::Vector3d(0, 0, 0.3) - position).normalized(),
                          x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
    c.T_map_camera.linear() << x, z.cross(x), z;
    c.T_map_camera.translation() = position;
    c.fixed = i == 0;
    s.truth.cameras.push_back(c);
  }
  for (int i = 0; i < points; ++i) s.truth.points.push_back(random.vector(1));
  for (int i = 0; i < cameras; ++i) {
    for (int k = 0; k < points; ++k) {
      const Eigen::Vector3d p = s.truth.cameras[i].T_map_camera.inverse() * s.truth.points[k];
      BundleProblem::Measurement m;
      m.camera = i;
      m.point = k;
      m.sigma = 1.0 / 525;
      m.normalized =
          p.head<2>() / p.z() + Eigen::Vector2d(random.gauss(pixel_noise / 525), random.gauss(pixel_noise / 525));
      if (depth) {
        m.depth_sigma = 0.003 * p.z() * p.z();
        m.depth = p.z() + random.gauss(m.depth_sigma * (pixel_noise > 0));
      }
      s.truth.measurements.push_back(m);
    }
  }
  s.problem = s.truth;
  for (auto& c : s.problem.cameras) {
    if (c.fixed) continue;
    c.T_map_camera.translation() += random.gaussVector(start_noise);
    c.T_map_camera.linear() = expSO3(random.gaussVector(start_noise / 2)) * c.T_map_camera.linear();
  }
  for (auto& p : s.problem.points) p += random.gaussVector(start_noise);
  return s;
}

double worstCamera(const Scene& s) {
  double worst = 0;
  for (std::size_t i = 0; i < s.truth.cameras.size(); ++i) {
    worst = std::max(
        worst,
        (s.problem.cameras[i].T_map_camera.translation() - s.truth.cameras[i].T_map_camera.translation()).norm());
  }
  return worst;
}

TEST(Bundle, ConvergesToTruthWithDepthAsScale) {
  Scene s = arc(1, 8, 120, 0, true, 0.05);
  BundleSettings settings;
  settings.max_iterations = 40;
  const BundleResult r = solveBundle(s.problem, settings);
  ASSERT_TRUE(r.usable) << r.message;
  EXPECT_LT(r.final_cost, 1e-4 * r.initial_cost);
  EXPECT_LT(worstCamera(s), 1e-3);
}

TEST(Bundle, MonocularKeepsScaleOfTwoFixedCameras) {
  Scene s = arc(2, 8, 120, 0.5, false, 0.04);
  s.problem.cameras[4] = s.truth.cameras[4];
  s.problem.cameras[4].fixed = true;
  BundleSettings settings;
  settings.max_iterations = 40;
  const BundleResult r = solveBundle(s.problem, settings);
  ASSERT_TRUE(r.usable);
  EXPECT_LT(worstCamera(s), 0.01);
  EXPECT_NEAR(r.rms, 0.5, 0.06);
}

/// What a camera whose k1 and readout time are larger than assumed by `error` sees of an arc.
Scene miscalibrated(unsigned seed, const CalibrationVector& error) {
  Scene s = arc(seed, 8, 120, 0.5, false, 0.01);
  Random random(seed + 1000);
  for (auto& m : s.problem.measurements) {
    const Eigen::Vector2d n =
        (s.truth.cameras[m.camera].T_map_camera.inverse() * s.truth.points[m.point]).hnormalized();
    m.by_calibration.col(0) = n.squaredNorm() * n;
    m.by_calibration.col(1) = random.gaussVector(0.3).head<2>();
    m.normalized -= m.by_calibration * error;
  }
  s.problem.calibration.emplace();
  s.problem.calibration->sigma << 0.1, 0.05;
  return s;
}

TEST(Bundle, EstimatesTheCalibrationAndHowWell) {
  const CalibrationVector error(0.05, -0.012);
  constexpr int kRuns = 40;
  BundleSettings settings;
  settings.max_iterations = 40;
  settings.pixel_sigma = 0.5;
  settings.loss = RobustLoss::kNone;
  double nees = 0;
  for (unsigned seed = 0; seed < kRuns; ++seed) {
    Scene s = miscalibrated(seed, error);
    for (auto& m : s.problem.measurements) m.sigma = 0.5 / 525;
    const auto before = s.problem.measurements;
    ASSERT_TRUE(solveBundle(s.problem, settings).usable);
    const CalibrationEstimate& found = *s.problem.calibration;
    nees += (found.error - error).dot(found.covariance.inverse() * (found.error - error)) / kRuns;
    EXPECT_NEAR(found.error[0], error[0], 5 * std::sqrt(found.covariance(0, 0)));
    EXPECT_NEAR(found.error[1], error[1], 5 * std::sqrt(found.covariance(1, 1)));
    EXPECT_LT(std::sqrt(found.covariance(0, 0)), 0.02);
    EXPECT_LT(std::sqrt(found.covariance(1, 1)), 0.001);
    // The measurements are then the calibrated camera's.
    EXPECT_LT(
        (s.problem.measurements[7].normalized - before[7].normalized - before[7].by_calibration * found.error).norm(),
        1e-12);
  }
  std::printf("squared error over its covariance: %.2f on average, 2 expected\n", nees);
  EXPECT_GT(nees, 1.2);
  EXPECT_LT(nees, 3.0);
}

TEST(Bundle, AHeldCalibrationStays) {
  Scene s = miscalibrated(1, {0.05, -0.012});
  s.problem.calibration->sigma << 1e-9, 0.05;
  BundleSettings settings;
  settings.max_iterations = 40;
  ASSERT_TRUE(solveBundle(s.problem, settings).usable);
  EXPECT_LT(std::abs(s.problem.calibration->error[0]), 1e-6);
  EXPECT_NEAR(s.problem.calibration->error[1], -0.012, 0.002);
  s.problem.calibration->sigma << 0, 0.05;
  EXPECT_THROW(solveBundle(s.problem, settings), std::invalid_argument);
}

TEST(Bundle, AJobKeepsACalibrationOnlyWhereItIsSurelyAnother) {
  BundleJob off, right, plain;
  off.problem = miscalibrated(2, {0.05, -0.012}).problem;
  right.problem = plain.problem = miscalibrated(2, {0, 0}).problem;
  plain.problem.calibration.reset();
  for (BundleJob* job : {&off, &right, &plain}) job->solve();
  ASSERT_TRUE(off.problem.calibration);
  EXPECT_NEAR(off.problem.calibration->error[1], -0.012, 0.002);
  EXPECT_FALSE(right.problem.calibration);
  // Then it is as if nobody had asked.
  for (std::size_t i = 0; i < plain.problem.cameras.size(); ++i)
    EXPECT_EQ(right.problem.cameras[i].T_map_camera.matrix(), plain.problem.cameras[i].T_map_camera.matrix());
  EXPECT_EQ(right.result.final_cost, plain.result.final_cost);
  // One that was for the calibration alone is of no use then.
  BundleJob found, nothing;
  found.problem = miscalibrated(2, {0.05, -0.012}).problem;
  nothing.problem = miscalibrated(2, {0, 0}).problem;
  for (BundleJob* job : {&found, &nothing}) {
    job->for_calibration = true;
    job->solve();
  }
  EXPECT_TRUE(found.result.usable);
  EXPECT_FALSE(nothing.result.usable);
  EXPECT_FALSE(nothing.problem.calibration);
}

TEST(Bundle, ReportsOutliers) {
  Scene s = arc(3, 6, 80, 0.3, true, 0.01);
  for (std::size_t i = 5; i < s.problem.measurements.size(); i += 37)
    s.problem.measurements[i].normalized += Eigen::Vector2d(0.05, -0.04);
  BundleSettings settings;
  settings.max_iterations = 30;
  const BundleResult r = solveBundle(s.problem, settings);
  std::size_t expected = 0;
  for (std::size_t i = 5; i < s.problem.measurements.size(); i += 37)
    expected += std::count(r.outliers.begin(), r.outliers.end(), static_cast<int>(i));
  EXPECT_EQ(expected, (s.problem.measurements.size() - 5 + 36) / 37);
  EXPECT_LE(r.outliers.size(), expected + 3);
  EXPECT_LT(worstCamera(s), 0.015);
}

TEST(Bundle, GravityLevelsAMapThatFloats) {
  Scene s = arc(4, 5, 80, 0, true, 0);
  // The whole map tilted; only the priors know which way is up.
  const Eigen::Matrix3d tilt = expSO3(Eigen::Vector3d(0.05, -0.03, 0));
  for (std::size_t i = 0; i < s.problem.cameras.size(); ++i) {
    auto& c = s.problem.cameras[i];
    c.up_camera = s.truth.cameras[i].T_map_camera.linear().transpose().col(2);
    c.up_sigma = 0.01;
    c.T_map_camera = Pose(tilt) * c.T_map_camera;
    c.fixed = false;
  }
  for (auto& p : s.problem.points) p = tilt * p;
  BundleSettings settings;
  settings.max_iterations = 60;
  solveBundle(s.problem, settings);
  for (const auto& c : s.problem.cameras)
    EXPECT_LT((c.T_map_camera.linear().transpose().col(2) - *c.up_camera).norm(), 2e-3);
}

TEST(Bundle, RefusesBadInput) {
  Scene s = arc(5, 3, 10, 0, false, 0);
  BundleProblem bad = s.problem;
  bad.measurements[0].point = 10;
  EXPECT_THROW(solveBundle(bad, {}), std::invalid_argument);
  bad = s.problem;
  bad.points[3].x() = NAN;
  EXPECT_THROW(solveBundle(bad, {}), std::invalid_argument);
}

/// The scene as a map, with one landmark a point.
Map mapOf(const Scene& s) {
  Map map;
  for (const auto& p : s.problem.points) map.addLandmark(p);
  for (std::size_t i = 0; i < s.problem.cameras.size(); ++i) {
    Keyframe k;
    k.stamp = i;
    k.T_map_camera = s.problem.cameras[i].T_map_camera;
    for (const auto& m : s.problem.measurements) {
      if (m.camera != static_cast<int>(i)) continue;
      Observation o;
      o.landmark = m.point;
      o.normalized = m.normalized;
      o.depth = m.depth;
      o.depth_sigma = m.depth_sigma;
      k.observations.push_back(o);
    }
    map.addKeyframe(std::move(k));
  }
  return map;
}

TEST(BundleJob, WindowMovesOnlyFreeKeyframesAndDropsOutliers) {
  Scene s = arc(6, 7, 90, 0.3, true, 0.02);
  for (int i = 0; i < 3; ++i) s.problem.cameras[i].T_map_camera = s.truth.cameras[i].T_map_camera;
  for (auto& m : s.problem.measurements) {
    if (m.camera == 5 && m.point == 7) m.normalized.x() += 0.08;
  }
  Map map = mapOf(s);
  const Pose before = map.keyframe(2).T_map_camera;
  BundleSettings settings;
  settings.max_iterations = 30;
  BundleJob job = extractBundle(map, synthetic::camera(), {3, 4, 5, 6}, {0, 1, 2}, settings);
  job.solve();
  ASSERT_TRUE(job.result.usable);
  applyBundle(job, map);
  EXPECT_EQ(before.matrix(), map.keyframe(2).T_map_camera.matrix());
  for (int i = 3; i < 7; ++i) {
    EXPECT_LT((map.keyframe(i).T_map_camera.translation() - s.truth.cameras[i].T_map_camera.translation()).norm(),
              0.01);
  }
  EXPECT_EQ(map.keyframe(5).observations[7].landmark, kNoLandmark);
  EXPECT_EQ(map.landmark(7).observations.size(), 6u);
}

TEST(PoseGraph, LoopRemovesDrift) {
  for (const bool four_dof : {false, true}) {
    Random random(7);
    constexpr int kNodes = 40;
    std::vector<Pose> truth;
    for (int i = 0; i < kNodes; ++i)
      truth.push_back(air_ground_common::yawPose(
          2 * M_PI * i / kNodes, {2 * std::cos(2 * M_PI * i / kNodes), 2 * std::sin(2 * M_PI * i / kNodes), 0.5}));
    std::vector<PoseGraphNode> nodes(kNodes);
    std::vector<PoseGraphEdge> edges;
    nodes[0].T_map_camera = truth[0];
    nodes[0].fixed = true;
    for (int i = 1; i < kNodes; ++i) {
      PoseGraphEdge e;
      e.a = i - 1;
      e.b = i;
      e.T_a_b = truth[i - 1].inverse() * truth[i] *
                air_ground_common::yawPose(0.003 + random.gauss(0.002), random.gaussVector(0.005));
      e.covariance.topLeftCorner<3, 3>() *= 1e-4;
      e.covariance.bottomRightCorner<3, 3>() *= 5e-5;
      nodes[i].T_map_camera = nodes[i - 1].T_map_camera * e.T_a_b;
      edges.push_back(e);
    }
    PoseGraphEdge loop;
    loop.a = kNodes - 1;
    loop.b = 0;
    loop.T_a_b = truth[kNodes - 1].inverse() * truth[0];
    loop.covariance = Matrix6d::Identity() * 1e-4;
    loop.robust = true;
    edges.push_back(loop);
    const double before = (nodes.back().T_map_camera.translation() - truth.back().translation()).norm();
    PoseGraphSettings settings;
    settings.four_dof = four_dof;
    const PoseGraphResult r = optimizePoseGraph(nodes, edges, settings);
    ASSERT_TRUE(r.usable);
    EXPECT_GT(before, 0.15);
    double worst = 0;
    for (int i = 0; i < kNodes; ++i)
      worst = std::max(worst, (nodes[i].T_map_camera.translation() - truth[i].translation()).norm());
    EXPECT_LT(worst, 0.4 * before) << "four_dof " << four_dof;
    EXPECT_LT((nodes.back().T_map_camera.translation() - truth.back().translation()).norm(), 0.03);
  }
  std::vector<PoseGraphNode> floating(2);
  EXPECT_THROW(optimizePoseGraph(floating, {}, {}), std::invalid_argument);
}

TEST(PoseGraph, CloseLoopsCarriesLandmarks) {
  Scene s = arc(8, 6, 60, 0, true, 0);
  Map map = mapOf(s);
  LoopEdge loop;
  loop.a = 0;
  loop.b = 5;
  // Says that the last camera stands 0.1 m further along its own x.
  loop.T_a_b = map.keyframe(0).T_map_camera.inverse() * map.keyframe(5).T_map_camera;
  loop.T_a_b.translation() += loop.T_a_b.linear() * Eigen::Vector3d(0.02, 0, 0);
  loop.covariance = Matrix6d::Identity() * 1e-8;
  const Pose before = map.keyframe(5).T_map_camera;
  ASSERT_TRUE(closeLoops(map, {loop}, 20, kNoKeyframe, {}).usable);
  const Eigen::Vector3d moved =
      before.linear().transpose() * (map.keyframe(5).T_map_camera.translation() - before.translation());
  EXPECT_GT(moved.x(), 0.004);
  // Landmarks whose first observer did not move stay.
  EXPECT_LT((map.landmark(0).position - s.problem.points[0]).norm(), 1e-9);
}

}  // namespace
}  // namespace visual_frontend
