// The whole chain on synthetic scenes with known truth.
#include <gtest/gtest.h>
#include <omp.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "air_ground_common/linear_algebra.h"
#include "icp_refine/height_check.h"
#include "icp_refine/icp.h"
#include "synthetic_scene.h"

namespace icp_refine {
namespace {

using synthetic::SceneSettings;
using synthetic::World;

YAML::Node shippedConfig() { return YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]; }

const IcpChain& shipped() {
  static const IcpChain chain(shippedConfig());
  return chain;
}

SceneSettings exact() {
  SceneSettings s;
  s.scale_error = s.aerial_noise = s.aerial_bumps = s.missing = s.ground_drift = 0;
  s.smooth_edges = false;
  return s;
}

// Offset of `distance` [m] in a horizontal direction and `angle` [rad] of yaw, about `centre` of the reading.
Pose offset(const Pose& T, const Eigen::Vector3d& centre, double distance, double direction, double angle) {
  const Eigen::Vector3d m = T * centre;
  const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  Pose D = Pose::Identity();
  D.linear() = R;
  D.translation() = m + distance * Eigen::Vector3d(std::cos(direction), std::sin(direction), 0.2) - R * m;
  return D * T;
}

struct Error {
  double translation, rotation;
};

Error errorAt(const Similarity& T, const Pose& truth, const Eigen::Vector3d& centre_reading) {
  return {(T * centre_reading - truth * centre_reading).norm(), air_ground_common::rotationAngle(T.R, truth.linear())};
}

// Error of the alignment about the covariance's centre: translation, rotation, relative scale.
Vector7d errorOf(const IcpResult& result, const synthetic::Scene& scene) {
  Vector7d e;
  const Eigen::Vector3d c = inverse(result.T_reference_reading) * result.centre;
  e.head<3>() = result.T_reference_reading * c - scene.truth * c;
  e.segment<3>(3) = air_ground_common::logSO3(result.T_reference_reading.R * scene.truth.R.transpose());
  e[6] = std::log(result.T_reference_reading.scale / scene.truth.scale);
  return e;
}

TEST(Icp, ConvergesFromTheWholeBasin) {
  for (unsigned seed : {1u, 2u}) {
    const auto scene = synthetic::makeScene(seed);
    const auto reference = shipped().prepareReference(scene.ground);
    const Cloud reading = shipped().prepareReading(scene.aerial);
    const Eigen::Vector3d centre = synthetic::centroid(scene.aerial);
    for (double distance : {0.25, 0.4}) {
      for (int k = 0; k < 4; ++k) {
        const double angle = (k % 2 ? 1 : -1) * (distance > 0.3 ? 8 : 5) * M_PI / 180;
        const Pose start = offset(scene.T_ground_map_mav_map, centre, distance, k * M_PI / 2 + 0.3, angle);
        const auto result = shipped().align(reading, reference, start);
        ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
        const auto e = errorAt(result.T_reference_reading, scene.T_ground_map_mav_map, centre);
        EXPECT_LT(e.translation, 0.08) << "seed " << seed << " distance " << distance << " case " << k;
        EXPECT_LT(e.rotation, 3 * M_PI / 180);
        EXPECT_TRUE(result.localizability.complete()) << result.localizability.describeMissing();
      }
    }
  }
}

TEST(Icp, MillimetresWithoutNoiseAndTheInverseIsTheInverse) {
  const auto scene = synthetic::makeScene(5, exact());
  const Eigen::Vector3d centre = synthetic::centroid(scene.aerial);
  const Pose start = offset(scene.T_ground_map_mav_map, centre, 0.2, 1.0, 0.06);
  const auto forward =
      shipped().align(shipped().prepareReading(scene.aerial), shipped().prepareReference(scene.ground), start);
  const auto e = errorAt(forward.T_reference_reading, scene.T_ground_map_mav_map, centre);
  EXPECT_LT(e.translation, 0.006);
  EXPECT_LT(e.rotation, 0.004);
  const auto backward = shipped().align(shipped().prepareReading(scene.ground),
                                        shipped().prepareReference(scene.aerial), start.inverse());
  const auto b = errorAt(inverse(backward.T_reference_reading), scene.T_ground_map_mav_map, centre);
  EXPECT_LT(b.translation, 0.012);
  EXPECT_LT(b.rotation, 0.008);
}

// Exact correspondences of random points with random normals.
struct Correspondences {
  Correspondences() {
    std::mt19937 rng(3);
    std::uniform_real_distribution<float> u(-2, 2);
    for (int i = 0; i < 300; ++i) {
      reference.points.emplace_back(u(rng) + 5, u(rng) - 3, u(rng));
      reference.normals.push_back(Eigen::Vector3f(u(rng), u(rng), u(rng)).normalized());
      matches.reference_index.push_back(i);
    }
    matches.weights.assign(300, 1);
  }
  Cloud reference;
  Matches matches;
};

TEST(Icp, JacobianEqualsFiniteDifferences) {
  const Correspondences c;
  const Cloud reading = transformed(
      c.reference, motion((Vector7d() << .1, -.2, .3, .1, -.1, .2, .1).finished(), synthetic::centroid(c.reference)));
  const MatchedClouds clouds{reading, c.reference, c.matches};
  const NormalEquations equations = normalEquations(clouds, c.matches.weights);
  Matrix7d hessian = Matrix7d::Zero();
  for (int i = 0; i < 300; ++i) {
    const Vector7d J = jacobian(clouds, i, equations.centre);
    hessian += J * J.transpose();
    const Eigen::Vector3d n = c.reference.normals[i].cast<double>(), p = reading.points[i].cast<double>();
    for (int k = 0; k < 7; ++k) {
      constexpr double kStep = 1e-5;
      const Vector7d step = kStep * Vector7d::Unit(k);
      const double difference = n.dot(motion(step, equations.centre) * p - motion(-step, equations.centre) * p);
      EXPECT_NEAR(J[k], difference / (2 * kStep), 1e-8) << "component " << k;
    }
  }
  EXPECT_LT((hessian - equations.hessian).cwiseAbs().maxCoeff(), 1e-9 * hessian.norm());
}

// One step: catches a wrong sign or a lever arm about the wrong point.
TEST(Icp, StepUndoesASmallMotion) {
  const Correspondences c;
  for (const auto& [dof, change] :
       {std::pair<int, Vector7d>{7, (Vector7d() << 0.01, -0.02, 0.03, 0.002, -0.003, 0.004, 0.005).finished()},
        std::pair<int, Vector7d>{6, (Vector7d() << 0.01, -0.02, 0.03, 0.002, -0.003, 0.004, 0).finished()},
        std::pair<int, Vector7d>{4, (Vector7d() << 0.01, -0.02, 0.03, 0, 0, 0.004, 0).finished()}}) {
    const Eigen::Vector3d centre = synthetic::centroid(c.reference);
    const Cloud reading = transformed(c.reference, motion(change, centre));
    const MatchedClouds clouds{reading, c.reference, c.matches};
    const auto equations = normalEquations(clouds, c.matches.weights);
    const ScalePrior free{ScalePrior::Mode::kFree, 1, 1};
    const auto localizability = analyzeLocalizability(clouds, c.matches.weights, equations, {}, free.mode);
    ASSERT_TRUE(localizability.complete()) << localizability.describeMissing();
    const Vector7d step = constrainedStep(equations, localizability, Matrix7d::Zero(), dof, free, {}, {});
    EXPECT_LT((step + change).cwiseAbs().maxCoeff(), 2e-4) << dof << ": " << step.transpose();
    EXPECT_LT((equations.centre - (centre + change.head<3>())).norm(), 1e-4);
  }
}

TEST(Icp, FourDegreesOfFreedomKeepTheTiltSixCorrectIt) {
  const auto scene = synthetic::makeScene(6, exact());
  const Eigen::Vector3d centre = synthetic::centroid(scene.aerial);
  const Eigen::Vector3d m = scene.T_ground_map_mav_map * centre;
  const Eigen::Matrix3d tilt = air_ground_common::expSO3({0.03, -0.02, 0});
  Pose D = Pose::Identity();
  D.linear() = tilt;
  D.translation() = m - tilt * m;
  const Pose start = D * scene.T_ground_map_mav_map;
  YAML::Node four = YAML::Clone(shippedConfig());
  for (auto level : four["levels"]) level["error_minimizer"]["PointToPlane"]["dof"] = 4;
  const IcpChain chain4(four);
  const auto r4 = chain4.align(chain4.prepareReading(scene.aerial), chain4.prepareReference(scene.ground), start);
  const auto r6 =
      shipped().align(shipped().prepareReading(scene.aerial), shipped().prepareReference(scene.ground), start);
  const auto up = [](const Eigen::Matrix3d& R) { return Eigen::Vector3d(R.row(2)); };
  EXPECT_LT((up(r4.T_reference_reading.R) - up(start.linear())).norm(), 1e-6);
  EXPECT_LT((up(r6.T_reference_reading.R) - up(scene.truth.R)).norm(), 0.004);
}

// Clouds that say that the maps lean apart, against robots that know their verticals.
TEST(Icp, TheTiltPriorHoldsMapsParallel) {
  const auto scene = synthetic::makeScene(6, exact());
  const Eigen::Vector3d centre = scene.T_ground_map_mav_map * synthetic::centroid(scene.aerial);
  const auto reference = shipped().prepareReference(scene.ground);
  for (const Eigen::Vector3d& lean : {Eigen::Vector3d(0.02, 0, 0), Eigen::Vector3d(-0.02, 0, 0),
                                      Eigen::Vector3d(0, 0.02, 0), Eigen::Vector3d(0, -0.02, 0)}) {
    Vector7d turn = Vector7d::Zero();
    turn.segment<3>(3) = -lean;
    const Pose& T = scene.T_ground_map_mav_map;
    const Pose D = poseOf(motion(turn, centre));
    const Cloud reading = shipped().prepareReading(transformed(scene.aerial, T.inverse() * D * T));
    const Eigen::Vector3d up = air_ground_common::expSO3(lean) * T.linear().col(2);
    Priors priors;
    const auto by_clouds = shipped().align(reading, reference, T, priors);
    priors.tilt_stddev = 0.0005;
    const auto held = shipped().align(reading, reference, T, priors);
    ASSERT_EQ(held.outcome, IcpResult::Outcome::kConverged) << held.reason;
    EXPECT_LT((by_clouds.T_reference_reading.R.col(2) - up).norm(), 0.003);
    EXPECT_LT((held.T_reference_reading.R.col(2) - Eigen::Vector3d::UnitZ()).norm(), 0.004) << lean.transpose();
    for (int axis : {3, 4}) EXPECT_LT(held.covariance(axis, axis), by_clouds.covariance(axis, axis));
    // A map that is known to lean is held by that, not by its z axis.
    (lean.x() > 0 ? priors.up_reading : priors.up_reference) = Eigen::Vector3d(0.01, -0.015, 1).normalized();
    const auto known = shipped().align(reading, reference, T, priors);
    EXPECT_LT((known.T_reference_reading.R * priors.up_reading - priors.up_reference).norm(), 0.005);
  }
}

TEST(Icp, FlatFloorFixesOnlyHeightAndTilt) {
  SceneSettings s;
  s.world = World::kFlat;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    const auto scene = synthetic::makeScene(seed, s);
    const Pose start = offset(scene.T_ground_map_mav_map, synthetic::centroid(scene.aerial), 0.2, seed, 0.05);
    const auto result =
        shipped().align(shipped().prepareReading(scene.aerial), shipped().prepareReference(scene.ground), start);
    ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
    int missing = 0;
    for (const auto& d : result.localizability.directions) {
      if (d.localizable) continue;
      ++missing;
      // x, y and yaw: nothing along z, nothing about x and y.
      EXPECT_LT(std::abs(d.v[2]) + std::abs(d.v[3]) + std::abs(d.v[4]), 0.2) << d.v.transpose();
    }
    EXPECT_EQ(missing, 3) << result.localizability.describeMissing();
    EXPECT_NE(result.localizability.describeMissing().find("about z"), std::string::npos);
    EXPECT_GT(std::sqrt(result.covariance(0, 0)), 0.5);
    EXPECT_GT(std::sqrt(result.covariance(1, 1)), 0.5);
    EXPECT_LT(std::sqrt(result.covariance(2, 2)), 0.1);
  }
}

TEST(Icp, CorridorIsFreeAlongItsAxis) {
  SceneSettings s;
  s.world = World::kCorridor;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const auto scene = synthetic::makeScene(seed, s);
    const auto result = shipped().align(shipped().prepareReading(scene.aerial),
                                        shipped().prepareReference(scene.ground), scene.T_ground_map_mav_map);
    ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
    ASSERT_FALSE(result.localizability.complete());
    const Eigen::Vector3d axis = scene.T_world_ground_map.linear().transpose() * Eigen::Vector3d::UnitX();
    int missing = 0;
    for (const auto& d : result.localizability.directions) {
      if (d.localizable) continue;
      ++missing;
      EXPECT_GT(std::abs(d.v.head<3>().dot(axis)), 0.97) << d.v.transpose();
    }
    EXPECT_EQ(missing, 1) << result.localizability.describeMissing();
  }
}

// NEES of 6 dimensions has mean 6 when the covariance is right; it includes drift and scale of the maps, which differ
// by scene.
TEST(Icp, CovarianceIsConsistent) {
  double sum = 0;
  int runs = 0, beyond = 0;
  for (unsigned seed = 100; seed < 116; ++seed) {
    const auto scene = synthetic::makeScene(seed);
    const auto result = shipped().align(shipped().prepareReading(scene.aerial),
                                        shipped().prepareReference(scene.ground), scene.T_ground_map_mav_map);
    ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged);
    EXPECT_TRUE(air_ground_common::isPositiveDefinite(result.covariance));
    const double nees = air_ground_common::squaredMahalanobis(errorOf(result, scene).head<6>(),
                                                              result.covariance.topLeftCorner<6, 6>());
    sum += nees;
    beyond += nees > 16.8;  // 99 % of chi^2 with 6 degrees of freedom
    ++runs;
  }
  EXPECT_GT(sum / runs, 2.0);
  EXPECT_LT(sum / runs, 8.0);
  EXPECT_LE(beyond, 2);
}

// Scale errors of the aerial map, as large as a weak odometry makes them, in exact clouds.
TEST(Icp, ScaleIsFoundWhereTheGeometryFixesIt) {
  int seed = 20;
  for (const double error : {0.005, -0.005, 0.02, -0.02, 0.05, -0.05}) {
    SceneSettings s = exact();
    s.scale_offset = error;
    const auto scene = synthetic::makeScene(++seed, s);
    const auto reference = shipped().prepareReference(scene.ground);
    const Cloud reading = shipped().prepareReading(scene.aerial);
    const Pose start =
        offset(scene.T_ground_map_mav_map, synthetic::centroid(scene.aerial), 0.15, seed, seed % 2 ? 0.05 : -0.05);
    for (const auto mode : {ScalePrior::Mode::kPrior, ScalePrior::Mode::kFree}) {
      const auto result = shipped().align(reading, reference, start, ScalePrior{mode, 1, 0.02});
      ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
      EXPECT_TRUE(result.scale_estimated);
      const Vector7d e = errorOf(result, scene);
      // The prior holds what may be distortion of the maps.
      EXPECT_LT(std::abs(e[6]), 0.0032) << "scale error " << error << " seed " << seed;
      EXPECT_LT(e.head<3>().norm(), 0.006);
      EXPECT_LT(e.segment<3>(3).norm(), 0.004);
    }
    // The ground cloud read against the aerial one: the inverse scale.
    const auto backward = shipped().align(shipped().prepareReading(scene.ground),
                                          shipped().prepareReference(scene.aerial), start.inverse());
    EXPECT_NEAR(backward.T_reference_reading.scale * scene.truth.scale, 1, 0.004);
    const auto fixed = shipped().align(reading, reference, start, ScalePrior{ScalePrior::Mode::kFixed, 1, 0.02});
    EXPECT_EQ(fixed.T_reference_reading.scale, 1);
    EXPECT_FALSE(fixed.scale_estimated);
  }
}

TEST(Icp, ScaleUnderNoise) {
  // Noise rounds edges, which makes the boxes of the aerial map larger: an error that grows with it.
  for (const auto& [noise, limit] : {std::pair<double, double>{0.004, 0.002}, {0.012, 0.004}, {0.03, 0.008}}) {
    SceneSettings s;
    s.scale_error = s.ground_drift = 0;
    s.scale_offset = -0.02;
    s.smooth_edges = false;
    s.aerial_noise = s.aerial_bumps = noise;
    std::vector<double> errors;
    for (unsigned seed = 60; seed < 65; ++seed) {
      const auto scene = synthetic::makeScene(seed, s);
      const auto result = shipped().align(shipped().prepareReading(scene.aerial),
                                          shipped().prepareReference(scene.ground), scene.T_ground_map_mav_map);
      ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
      errors.push_back(std::abs(errorOf(result, scene)[6]));
    }
    std::sort(errors.begin(), errors.end());
    EXPECT_LT(errors[2], limit) << "noise " << noise;
    EXPECT_LT(errors[4], 2.5 * limit) << "noise " << noise;
  }
}

// A plane, or walls along one direction and a floor, leave the scale of a direction open: the prior holds it.
TEST(Icp, ThePriorHoldsAScaleThatTheGeometryDoesNotFix) {
  SceneSettings s;
  s.world = World::kFlat;
  s.scale_error = 0;
  s.scale_offset = 0.03;
  const auto scene = synthetic::makeScene(3, s);
  const auto reading = shipped().prepareReading(scene.aerial);
  const auto reference = shipped().prepareReference(scene.ground);
  for (const auto mode : {ScalePrior::Mode::kPrior, ScalePrior::Mode::kFree}) {
    const auto result = shipped().align(reading, reference, scene.T_ground_map_mav_map, ScalePrior{mode, 1, 0.02});
    ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
    EXPECT_FALSE(result.scale_estimated);
    EXPECT_NEAR(result.T_reference_reading.scale, 1, 1e-9);
    const bool prior = mode == ScalePrior::Mode::kPrior;
    EXPECT_NEAR(std::sqrt(result.covariance(6, 6)), prior ? 0.02 : 0.7, prior ? 0.003 : 0.6);
    EXPECT_EQ(result.localizability.describeMissing().find("scale") == std::string::npos, prior);
  }
}

// With maps without drift and noisy clouds the seven errors agree with their covariance: the mean NEES is 7, and its
// own standard deviation over 50 runs sqrt(2 * 7 / 50) = 0.53. map_scale_sigma stays: it stands for edges rounded by
// noise.
TEST(Icp, CovarianceWithScaleIsConsistent) {
  YAML::Node config = shippedConfig();
  for (const char* name : {"map_translation_sigma", "map_rotation_sigma"}) config["covariance"][name] = 0;
  const IcpChain chain(config);
  SceneSettings s;
  s.ground_drift = 0;
  s.scale_error = 0.01;
  s.smooth_edges = false;
  double sum = 0, sum_scale = 0;
  constexpr int kRuns = 50;
  for (unsigned seed = 200; seed < 200 + kRuns; ++seed) {
    const auto scene = synthetic::makeScene(seed, s);
    const auto result = chain.align(chain.prepareReading(scene.aerial), chain.prepareReference(scene.ground),
                                    scene.T_ground_map_mav_map, ScalePrior{ScalePrior::Mode::kPrior, 1, 0.01});
    ASSERT_EQ(result.outcome, IcpResult::Outcome::kConverged) << result.reason;
    const Vector7d e = errorOf(result, scene);
    sum += air_ground_common::squaredMahalanobis(e, result.covariance);
    sum_scale += e[6] * e[6] / result.covariance(6, 6);
  }
  EXPECT_GT(sum / kRuns, 4.0);
  EXPECT_LT(sum / kRuns, 9.0);
  EXPECT_GT(sum_scale / kRuns, 0.3);
  EXPECT_LT(sum_scale / kRuns, 1.8);
}

TEST(Icp, SameInputSameOutputForAnyNumberOfThreads) {
  const auto scene = synthetic::makeScene(9);
  const Pose start = offset(scene.T_ground_map_mav_map, synthetic::centroid(scene.aerial), 0.3, 2, 0.1);
  const auto run = [&](int threads) {
    omp_set_num_threads(threads);
    return shipped().align(shipped().prepareReading(scene.aerial), shipped().prepareReference(scene.ground), start);
  };
  const auto a = run(1), b = run(2), c = run(2);
  for (const auto* other : {&b, &c}) {
    EXPECT_EQ(a.T_reference_reading.R, other->T_reference_reading.R);
    EXPECT_EQ(a.T_reference_reading.t, other->T_reference_reading.t);
    EXPECT_EQ(a.T_reference_reading.scale, other->T_reference_reading.scale);
  }
  EXPECT_EQ(a.covariance, b.covariance);
}

TEST(Icp, PoorDataFailsWithAReason) {
  auto scene = synthetic::makeScene(2);
  const auto reference = shipped().prepareReference(scene.ground);
  const auto reading = shipped().prepareReading(scene.aerial);
  const auto reasonOf = [&](const Cloud& r, const IcpReference& f, const Pose& T) {
    const auto result = shipped().align(r, f, T);
    EXPECT_EQ(result.outcome, IcpResult::Outcome::kFailed);
    EXPECT_FALSE(result.reason.empty());
    EXPECT_TRUE(result.T_reference_reading.t.allFinite() || !T.matrix().allFinite());
    return result.reason;
  };
  EXPECT_NE(reasonOf(Cloud{}, reference, Pose::Identity()).find("reading"), std::string::npos);
  EXPECT_NE(reasonOf(reading, shipped().prepareReference(Cloud{}), Pose::Identity()).find("reference"),
            std::string::npos);
  const Pose far(Eigen::Translation3d(100, 0, 0));
  EXPECT_NE(reasonOf(reading, reference, far).find("overlap"), std::string::npos);
  Pose broken = Pose::Identity();
  broken.matrix()(0, 3) = std::nan("");
  EXPECT_NE(reasonOf(reading, reference, broken).find("initial guess"), std::string::npos);
  // Points that are not finite are dropped before anything else.
  for (std::size_t i = 0; i < scene.aerial.size(); i += 7) scene.aerial.points[i].y() = std::nanf("");
  scene.aerial.points[3].x() = INFINITY;
  const auto result = shipped().align(shipped().prepareReading(scene.aerial), reference, scene.T_ground_map_mav_map);
  EXPECT_EQ(result.outcome, IcpResult::Outcome::kConverged);
}

TEST(HeightCheck, TellsTheTruthFromAWrongBasin) {
  int wrong_basins = 0;
  for (unsigned seed = 1; seed <= 2; ++seed) {
    const auto scene = synthetic::makeScene(seed);
    const auto reference = shipped().prepareReference(scene.ground);
    const GroundHeights heights(reference.cloud());
    const Cloud reading = shipped().prepareReading(scene.aerial);
    const auto right = heights.check(transformed(reading, scene.T_ground_map_mav_map));
    EXPECT_TRUE(right.conclusive);
    EXPECT_GT(right.agreement(), 0.85) << "seed " << seed;
    for (int k = 0; k < 4; ++k) {
      const Pose start = offset(scene.T_ground_map_mav_map, synthetic::centroid(reading), 0.8, k * M_PI / 2, 0.5);
      const auto result = shipped().align(reading, reference, start);
      if (errorAt(result.T_reference_reading, scene.T_ground_map_mav_map, synthetic::centroid(reading)).translation <
          0.15)
        continue;
      ++wrong_basins;
      const auto wrong = heights.check(transformed(reading, result.T_reference_reading));
      EXPECT_LT(wrong.agreement(), 0.65) << "seed " << seed << " case " << k;
    }
  }
  EXPECT_GE(wrong_basins, 2);
}

TEST(HeightCheck, SaysNothingWithoutRelief) {
  SceneSettings s;
  s.world = World::kFlat;
  const auto scene = synthetic::makeScene(1, s);
  const auto check = GroundHeights(scene.ground).check(transformed(scene.aerial, scene.T_ground_map_mav_map));
  EXPECT_GT(check.cells, 100);
  EXPECT_FALSE(check.conclusive);
  EXPECT_EQ(GroundHeights(Cloud{}).check(Cloud{}).cells, 0);
}

}  // namespace
}  // namespace icp_refine
