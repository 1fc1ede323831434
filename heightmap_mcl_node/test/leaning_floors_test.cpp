// Maps whose floors lean: a slope, a ground robot without IMU on one, an odometry that is not level yet.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "heightmap_mcl/dominant_floor.h"
#include "kept_maps.h"
#include "synthetic_world.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::expSO3;

constexpr double kDegree = M_PI / 180;

/// Where the estimate puts the MAV, against the truth of a ground map that R_map_level has turned [m].
double errorOf(const CoarseEstimate& e, const synthetic::Run& run, std::size_t k, const Eigen::Matrix3d& R_map_level) {
  const Eigen::Vector3d& mav = run.aerial[k].reference;
  return (e.similarityPose() * mav - R_map_level * (run.T_ground_mav[k] * mav)).norm();
}

TEST(LeaningFloors, AreNoObstacle) {
  const Eigen::Matrix3d R_map_level = expSO3(kDegree * Eigen::Vector3d(1.5, -1, 0));
  int converged = 0;
  for (const int seed : {41, 42, 43}) {
    synthetic::Options options;
    options.seed = seed;
    options.tilt = 1.5 * kDegree;
    options.aerial_clouds = 4;
    synthetic::Run run = synthetic::makeRun(options);
    for (Eigen::Vector3f& p : run.ground) p = R_map_level.cast<float>() * p;
    HeightMapLocalizer localizer({});
    ASSERT_TRUE(localizer.setGround(run.ground));
    for (const AerialCloud& cloud : run.aerial) ASSERT_TRUE(localizer.addAerial(cloud));
    const CoarseEstimate& e = localizer.estimate();
    std::printf("seed %d: %s, %.3f m, %s\n", seed, toString(e.status), errorOf(e, run, 3, R_map_level),
                e.reason.c_str());
    EXPECT_LT(errorOf(e, run, 3, R_map_level), 0.15);
    const Eigen::Matrix3d R = R_map_level * run.T_ground_mav[3].linear();
    EXPECT_LT(air_ground_common::rotationAngle(e.similarityPose().linear(), R), 2.5 * kDegree);
    converged += e.status == Status::kConverged;
  }
  EXPECT_EQ(converged, 3);
}

TEST(LeaningFloors, OnlyWhatIsFlatIsLevelled) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> u(-4, 4);
  std::normal_distribution<float> noise(0, 0.01f);
  std::vector<Eigen::Vector3f> slope, terrain, steep;
  for (int i = 0; i < 20000; ++i) {
    const float x = u(random), y = u(random), n = noise(random);
    slope.emplace_back(x, y, 0.03f * x + n + (i % 4 == 0 ? 0.5f : 0.f));
    terrain.emplace_back(x, y, 0.03f * x + 0.25f * std::sin(1.5f * x) * std::cos(1.2f * y) + n);
    steep.emplace_back(x, y, 0.1f * x + n);
  }
  const FloorRule rule = flatFloorRule(0.05);
  const auto floor = findDominantFloor(slope, Eigen::Vector3d::UnitZ(), rule);
  ASSERT_TRUE(floor);
  EXPECT_LT(std::acos(floor->up.dot(Eigen::Vector3d(-0.03, 0, 1).normalized())), 0.1 * kDegree);
  EXPECT_FALSE(findDominantFloor(terrain, Eigen::Vector3d::UnitZ(), rule));
  EXPECT_FALSE(findDominantFloor(steep, Eigen::Vector3d::UnitZ(), rule));
}

TEST(LeaningFloors, CloudsInMetresAreLevelledAboveAFlatGroundMap) {
  std::vector<Eigen::Vector3f> cloud;
  const Eigen::Matrix3f R = expSO3({0.02, 0.01, 0}).cast<float>();
  for (int i = 0; i < 100; ++i)
    for (int j = 0; j < 100; ++j)
      cloud.push_back(R * Eigen::Vector3f(0.02f * i, 0.02f * j, i < 50 && j < 50 ? 0.5f : 0.f));
  KeptMaps kept{HeightMapLocalizerSettings()};
  ASSERT_TRUE(kept.add({cloud, {1, 1, 2}}, nullptr));
  EXPECT_FALSE(kept.updateLevel(false));
  ASSERT_TRUE(kept.updateLevel(true));
  EXPECT_GT((kept.level() * R.cast<double>()).col(2).z(), std::cos(0.001));
  kept.remake();
  EXPECT_TRUE(kept.updateLevel(false)) << "a ground map without a flat floor took its place";
  EXPECT_TRUE(kept.level().isIdentity());
}

}  // namespace
}  // namespace heightmap_mcl
