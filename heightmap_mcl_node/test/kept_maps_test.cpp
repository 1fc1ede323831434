// Which clouds are kept, and how level and scale change them.
#include "kept_maps.h"

#include <gtest/gtest.h>

#include <cmath>

#include "air_ground_common/geometry.h"

namespace heightmap_mcl {
namespace {

/// A floor of 2 x 2 [m] with a block of 0.5 m on it, its corner at (x, 0).
std::vector<Eigen::Vector3f> block(float x = 0) {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 100; ++i)
    for (int j = 0; j < 100; ++j)
      points.emplace_back(x + 0.02f * i + 0.01f, 0.02f * j + 0.01f, i < 50 && j < 50 ? 0.5f : 0.f);
  return points;
}

HeightMapLocalizerSettings keeping(int verify) {
  HeightMapLocalizerSettings settings;
  settings.verify = settings.accumulate = verify;
  settings.air_map.max_extent = 10;
  return settings;
}

TEST(KeptMaps, TheLastOnesAreKept) {
  KeptMaps kept(keeping(3));
  EXPECT_TRUE(kept.empty());
  for (int k = 0; k < 5; ++k) ASSERT_TRUE(kept.add({block(), {0.1 * k, 0, 2}}, nullptr));
  EXPECT_EQ(kept.size(), 3u);
  EXPECT_DOUBLE_EQ(kept.reference().x(), 0.4);
  EXPECT_FALSE(kept.add({{}, {9, 9, 9}}, nullptr)) << "a cloud without a cell";
  EXPECT_EQ(kept.size(), 3u);
  EXPECT_DOUBLE_EQ(kept.reference().x(), 0.4);
}

TEST(KeptMaps, TheOldestAreDroppedWhereAllReachTooFar) {
  KeptMaps kept(keeping(4));
  for (const float x : {0.f, 4.f, 8.5f}) ASSERT_TRUE(kept.add({block(x), {x, 0, 2}}, nullptr));
  kept.dropFar();
  EXPECT_EQ(kept.farDropped(), 1u);
  EXPECT_EQ(kept.size(), 2u);
  EXPECT_NEAR(kept.merged(4).origin_x, 4, 0.05);
  EXPECT_NEAR(kept.merged(1).origin_x, 8.5, 0.05);
}

TEST(KeptMaps, CloudsComeBackAsTheyWere) {
  KeptMaps kept(keeping(4));
  for (const float x : {0.f, 1.f}) ASSERT_TRUE(kept.add({block(x), {x, 0, 2}}, nullptr));
  const HeightMap before = kept.merged(4);
  auto clouds = kept.takeAll();
  EXPECT_TRUE(kept.empty());
  for (auto& cloud : clouds) kept.giveBack(std::move(cloud));
  EXPECT_EQ(kept.merged(4).width, before.width);
  EXPECT_DOUBLE_EQ(kept.reference().x(), 1);
}

TEST(KeptMaps, TheFloorThatIsSetHoldsForWhatIsMerged) {
  KeptMaps kept(keeping(2));
  ASSERT_TRUE(kept.add({block(), {0, 0, 2}}, nullptr));
  EXPECT_NEAR(kept.merged(1).floor, 0, 0.02);
  kept.setFloor(-0.7);
  EXPECT_DOUBLE_EQ(kept.merged(1).floor, -0.7);
  EXPECT_NEAR(kept.mergedOnOwnFloor().floor, 0, 0.02);
  // The block now stands 1.2 m above the floor: more than the cap.
  EXPECT_NEAR(kept.merged(1).at(20, 20), 0.3f, 1e-6);
  kept.setFloor(std::nan(""));
  EXPECT_NEAR(kept.merged(1).floor, 0, 0.02);
}

TEST(KeptMaps, CloudsOfAnotherUnitAreMadeLevelAndMetric) {
  KeptMaps kept(keeping(2));
  kept.setOwnUnit(true);
  const Eigen::Matrix3d R_raw_level = air_ground_common::expSO3({0.2, -0.1, 0});
  constexpr double kUnit = 0.5;
  std::vector<Eigen::Vector3f> raw;
  for (const auto& p : block()) raw.push_back((R_raw_level * p.cast<double>() / kUnit).cast<float>());
  ASSERT_TRUE(kept.add({raw, R_raw_level * Eigen::Vector3d(1, 2, 3) / kUnit}, nullptr));
  EXPECT_TRUE(kept.updateLevel(false));
  EXPECT_FALSE(kept.updateLevel(false)) << "level already";
  kept.remake(kUnit);
  EXPECT_DOUBLE_EQ(kept.scale(), kUnit);
  const Eigen::Vector3d up = kept.level() * R_raw_level * Eigen::Vector3d::UnitZ();
  EXPECT_GT(up.z(), std::cos(0.01));
  // A turn about the vertical is left open, distances from the origin are not.
  EXPECT_NEAR(kept.reference().norm(), std::hypot(1, 2), 0.05);
  const LevelCloud level = kept.levelCloud(raw.size());
  EXPECT_EQ(level.points.size(), raw.size());
  EXPECT_NEAR(kUnit * level.centre.norm(), std::hypot(1, 1), 0.1);
  EXPECT_LE(kept.levelCloud(1000).points.size(), 1000u);
  kept.clear();
  EXPECT_DOUBLE_EQ(kept.scale(), 1);
  EXPECT_TRUE(kept.ownUnit()) << "what the clouds to come are";
}

// A drone's camera that looks half down, and nothing says how it is mounted: the map's z axis leans by 50 degrees.
TEST(KeptMaps, CloudsAreLevelWhereTheMavSaysThatUpIs) {
  const Eigen::Matrix3d R_raw_level = air_ground_common::expSO3({0, 0.87, 0});
  std::vector<Eigen::Vector3f> raw;
  for (const auto& p : block()) raw.push_back((R_raw_level * p.cast<double>()).cast<float>());
  const auto leanWith = [&](const air_ground_common::Vertical& vertical) {
    KeptMaps kept(keeping(2));
    kept.setOwnUnit(true);
    kept.setVertical(vertical);
    EXPECT_TRUE(kept.add({raw, Eigen::Vector3d::Zero()}, nullptr));
    kept.updateLevel(false);
    return std::acos(std::min(1.0, (kept.level() * R_raw_level * Eigen::Vector3d::UnitZ()).z()));
  };
  EXPECT_GT(leanWith({}), 0.3) << "beyond max_tilt of the map's z axis";
  const Eigen::Vector3d nearly = air_ground_common::expSO3({0.03, -0.03, 0}) * R_raw_level.col(2);
  EXPECT_LT(leanWith({nearly, 0.03}), 0.01) << "the floor tells the rest";
  const Eigen::Vector3d far = air_ground_common::expSO3({0, -0.4, 0}) * R_raw_level.col(2);
  EXPECT_NEAR(leanWith({far, 0.03}), 0.4, 0.01) << "no floor near there: as the MAV says";
}

}  // namespace
}  // namespace heightmap_mcl
