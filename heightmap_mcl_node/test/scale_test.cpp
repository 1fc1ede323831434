// Level and scale of clouds from a MAV without IMU, on worlds with exact truth.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <random>

#include "heightmap_mcl/dominant_floor.h"
#include "heightmap_mcl/localizer.h"
#include "synthetic_world.h"

using namespace heightmap_mcl;
using air_ground_common::expSO3;

namespace {

using synthetic::OwnUnit;

struct Result {
  CoarseEstimate estimate;
  double scale_error = 0, tilt = 0, position = 0, first_converged = -1;
  int wrong = 0;
};

Result play(const synthetic::Run& run, const OwnUnit& own, const HeightMapLocalizerSettings& settings = {}) {
  HeightMapLocalizer localizer(settings);
  localizer.setOwnUnit(true);
  EXPECT_TRUE(localizer.setGround(run.ground));
  Result r;
  for (std::size_t k = 0; k < run.aerial.size(); ++k) {
    const AerialCloud raw = own.raw(run.aerial[k]);
    const auto start = std::chrono::steady_clock::now();
    EXPECT_TRUE(localizer.addAerial(raw));
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const CoarseEstimate& e = localizer.estimate();
    // Where the estimate puts the MAV, against the truth.
    const Eigen::Vector3d there = e.similarityPose() * (e.scale * raw.reference);
    r.position = (there - run.T_ground_mav[k] * run.aerial[k].reference).head<2>().norm();
    r.scale_error = e.scale / own.unit - 1;
    const Eigen::Vector3d up = e.R_level * own.R_raw_level * Eigen::Vector3d::UnitZ();
    r.tilt = std::acos(std::min(1.0, up.z()));
    const bool right = r.position < 0.25 && std::abs(r.scale_error) < 0.1;
    r.wrong += e.status == Status::kConverged && !right;
    if (e.status == Status::kConverged && r.first_converged < 0) r.first_converged = static_cast<double>(k + 1);
    std::cout << k << " " << toString(e.status) << " scale " << e.scale << " +- " << e.scale_stddev << " error "
              << r.scale_error << " tilt " << r.tilt << " position " << r.position << " evidence " << e.scale_evidence
              << " " << e.reason << " " << seconds << " s\n";
    r.estimate = e;
  }
  return r;
}

TEST(DominantFloor, IsFoundAmongWallsInAnyUnit) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> u(-1, 1);
  std::normal_distribution<float> noise(0, 0.004f);
  const Eigen::Matrix3f R = expSO3({0.3, -0.2, 0.1}).cast<float>();
  const FloorRule rule{0.6, 0.1, 0, 0};
  for (const float unit : {0.01f, 1.f, 40.f}) {
    std::vector<Eigen::Vector3f> points;
    for (int i = 0; i < 6000; ++i) points.push_back(unit * (R * Eigen::Vector3f(u(random), u(random), noise(random))));
    // Two walls with more points than the floor.
    for (int i = 0; i < 9000; ++i)
      points.push_back(unit * (R * Eigen::Vector3f(u(random), 1 + noise(random), 1 + u(random))));
    for (int i = 0; i < 2000; ++i) points.push_back(unit * (R * Eigen::Vector3f(u(random), u(random), u(random))));
    const auto floor = findDominantFloor(points, Eigen::Vector3d::UnitZ(), rule);
    ASSERT_TRUE(floor);
    EXPECT_LT(std::acos(std::min(1.0, floor->up.dot(R.cast<double>().col(2)))), 0.5 * M_PI / 180) << unit;
    EXPECT_NEAR(floor->share, 6.0 / 17, 0.05);
  }
  std::vector<Eigen::Vector3f> wall;
  for (int i = 0; i < 3000; ++i) wall.push_back({u(random), noise(random), u(random)});
  EXPECT_FALSE(findDominantFloor(wall, Eigen::Vector3d::UnitZ(), rule)) << "a wall is no floor";
  EXPECT_FALSE(findDominantFloor({}, Eigen::Vector3d::UnitZ(), rule));
}

TEST(OwnUnit, ScaledAndTiltedCloudsAreFound) {
  synthetic::Options options;
  options.aerial_clouds = 5;
  options.scale_error = 0;
  int converged = 0;
  for (const auto& [seed, unit] : std::vector<std::pair<int, double>>{{601, 0.37}, {602, 9.0}}) {
    options.seed = static_cast<std::uint64_t>(seed);
    const auto run = synthetic::makeRun(options);
    const OwnUnit own{unit, expSO3({0.15, -0.2, 0.0})};
    const Result r = play(run, own);
    EXPECT_EQ(r.wrong, 0) << seed;
    EXPECT_LT(std::abs(r.scale_error) * unit, 2 * r.estimate.scale_stddev) << seed;
    EXPECT_LT(r.tilt, 1.5 * M_PI / 180) << seed;
    EXPECT_LT(r.position, 0.15) << seed;
    EXPECT_LT(r.estimate.scale_stddev / unit, 0.06);
    converged += r.estimate.status == Status::kConverged;
  }
  EXPECT_EQ(converged, 2);
}

// Large cells widen faces towards where they were seen from, and made it 2 % too small.
TEST(OwnUnit, ScaleHasNoBiasWhereDepthIsExact) {
  synthetic::Options options;
  options.aerial_clouds = 3;
  options.scale_error = options.drift_per_metre = options.yaw_drift_per_metre = options.ground_noise = 0;
  HeightMapLocalizerSettings settings;
  settings.own_unit.scale_min = 0.85;
  settings.own_unit.scale_max = 1.18;
  std::vector<double> errors;
  for (options.seed = 620; options.seed < 625; ++options.seed) {
    const Result r = play(synthetic::makeRun(options), {}, settings);
    if (r.position < 0.15) errors.push_back(r.scale_error);
  }
  ASSERT_GE(errors.size(), 4u);
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(std::abs(errors[errors.size() / 2]), 0.01);
}

TEST(OwnUnit, AnotherWorldIsNotVerified) {
  synthetic::Options options;
  options.aerial_clouds = 2;
  options.scale_error = 0;
  HeightMapLocalizerSettings settings;
  settings.own_unit.scale_min = 0.5;
  settings.own_unit.scale_max = 2;
  for (const auto world : {synthetic::World::kBoxes, synthetic::World::kIdenticalBoxes}) {
    options.world = world;
    options.other_world = world == synthetic::World::kBoxes;
    options.seed = 641;
    EXPECT_LT(play(synthetic::makeRun(options), {}, settings).first_converged, 0);
  }
}

// One scale alone is tried: that it has no rival says nothing for it, in a world where the MAV is not.
TEST(OwnUnit, AScaleWithoutRivalHasNoMoreEvidenceThanItsFit) {
  synthetic::Options options;
  options.aerial_clouds = 2;
  options.other_world = true;
  options.seed = 641;
  HeightMapLocalizerSettings settings;
  settings.own_unit.scale_min = 0.99;
  settings.own_unit.scale_max = 1.01;
  const Result r = play(synthetic::makeRun(options), {}, settings);
  EXPECT_TRUE(std::isfinite(r.estimate.scale_evidence));
  EXPECT_LT(r.first_converged, 0);
}

// A ground map of another scene fits at some scale, too: not the one for the map that comes next.
TEST(OwnUnit, ScaleEndsWithTheGroundMap) {
  synthetic::Options options;
  options.aerial_clouds = 3;
  options.scale_error = 0;
  HeightMapLocalizerSettings settings;
  settings.air_map.resolution = settings.ground_map.resolution = 0.04;
  settings.coarse_factor = 2;
  settings.own_unit.scale_min = 0.7;
  settings.own_unit.scale_max = 3.5;
  options.seed = 31;
  const synthetic::Run run = synthetic::makeRun(options);
  options.seed = 81;
  options.aerial_clouds = 1;
  const synthetic::Run other = synthetic::makeRun(options);
  const OwnUnit own{2.5, Eigen::Matrix3d::Identity()};
  HeightMapLocalizer localizer(settings);
  localizer.setOwnUnit(true);
  ASSERT_TRUE(localizer.setGround(other.ground));
  for (const AerialCloud& cloud : run.aerial) ASSERT_TRUE(localizer.addAerial(own.raw(cloud)));
  EXPECT_GT(std::abs(localizer.estimate().scale / own.unit - 1), 0.1);
  localizer.forgetGround();
  EXPECT_EQ(localizer.estimate().scale_evidence, 0);
  ASSERT_TRUE(localizer.setGround(run.ground));
  EXPECT_NEAR(localizer.estimate().scale / own.unit, 1, 0.1) << localizer.estimate().reason;
  EXPECT_EQ(localizer.estimate().status, Status::kConverged) << localizer.estimate().reason;
}

TEST(OwnUnit, AFlatFloorHasNoScale) {
  synthetic::Options options;
  options.world = synthetic::World::kFlatFloor;
  options.aerial_clouds = 4;
  const Result r = play(synthetic::makeRun(options), {0.5, Eigen::Matrix3d::Identity()});
  EXPECT_NE(r.estimate.status, Status::kConverged);
  EXPECT_LT(r.first_converged, 0);
}

}  // namespace
