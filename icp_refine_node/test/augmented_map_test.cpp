// The augmented map: aerial voxels, what the air adds, alignment and scale.
#include "icp_refine/augmented_map.h"

#include <gtest/gtest.h>

#include <cmath>

namespace icp_refine {
namespace {

TEST(AerialVoxels, GrowRatherThanExceedTheirNumber) {
  AerialVoxels voxels(0.1, 100);
  for (int x = 0; x < 40; ++x) {
    for (int y = 0; y < 40; ++y) voxels.add({0.1f * x + 0.05f, 0.1f * y + 0.05f, 0.05f}, 80);
  }
  EXPECT_LE(voxels.size(), 100u);
  EXPECT_FLOAT_EQ(voxels.leaf(), 0.4f);
  int count = 0;
  for (const auto& p : voxels.points()) {
    count += p.count;
    EXPECT_EQ(p.grey, 80);
  }
  EXPECT_EQ(count, 1600);
  voxels.clear();
  EXPECT_FLOAT_EQ(voxels.leaf(), 0.1f);
}

TEST(AerialVoxels, AverageIgnoreNanAndCount) {
  AerialVoxels voxels(0.1);
  voxels.add({0.02f, 0.02f, 0.02f}, 100);
  voxels.add({0.06f, 0.06f, 0.06f}, 200);
  voxels.add({0.5f, 0, 0}, 50);
  voxels.add({std::nanf(""), 0, 0}, 50);
  voxels.add({0, 0, 0}, std::nanf(""));
  voxels.add({1e9f, 0, 0}, 1);
  ASSERT_EQ(voxels.size(), 2u);
  const auto points = voxels.points();
  EXPECT_NEAR(points[0].position.x(), 0.04, 1e-6);
  EXPECT_EQ(points[0].grey, 150);
  EXPECT_EQ(points[1].grey, 50);
  EXPECT_EQ(voxels.points(2).size(), 1u);
}

TEST(AddedByAir, OnlyWhereTheGroundRobotSawNothing) {
  const std::vector<Eigen::Vector3f> ground{{0, 0, 0}}, aerial{{0.05f, 0, 0}, {0, 0.5f, 0}, {0, 0, 0.3f}};
  EXPECT_EQ(addedByAir(aerial, ground, 0.1), (std::vector<char>{0, 1, 1}));
}

TEST(AugmentedMap, HoldsAerialPointsOnlyWhileAligned) {
  AugmentedMap map({});
  map.setGround({{{1, 0, 0}, {10, 20, 30}, 1}});
  map.addAerial(1, {{{0, 2, 0}, {77, 77, 77}, 1}});
  ASSERT_EQ(map.points().size(), 1u);
  EXPECT_EQ(map.points()[0].source, 0);
  EXPECT_EQ(map.points()[0].rgb[0], 220) << "red";

  Pose T = Pose::Identity();
  T.translation() = Eigen::Vector3d(0, 0, 5);
  map.align(similarity(T));
  ASSERT_EQ(map.points().size(), 2u);
  EXPECT_EQ(map.points()[1].source, 1);
  EXPECT_EQ(map.points()[1].rgb[1], 77);
  EXPECT_LT((map.points()[1].position - Eigen::Vector3f(0, 2, 5)).norm(), 1e-6);
  map.clearGround();
  EXPECT_EQ(map.points().size(), 1u);
  map.align(std::nullopt);
  EXPECT_FALSE(map.aligned());
  EXPECT_TRUE(map.points().empty());
}

TEST(AugmentedMap, AppliesTheScale) {
  AugmentedMap map({});
  map.addAerial(1, {{{0, 2, 0}, {77, 77, 77}, 1}});
  map.align(Similarity{0.5, Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {0, 0, 5}});
  ASSERT_EQ(map.points().size(), 1u);
  EXPECT_LT((map.points()[0].position - Eigen::Vector3f(-1, 0, 5)).norm(), 1e-6);
}

TEST(AugmentedMap, AerialCloudsFollowTheirMap) {
  AugmentedMap map({});
  map.align(similarity(Pose::Identity()));
  map.addAerial(1, {{{0, 2, 0}, {77, 77, 77}, 1}});
  map.addAerial(2, {{{0, 4, 0}, {78, 78, 78}, 1}});
  map.addAerial(3, {{{0, 6, 0}, {79, 79, 79}, 1}});
  map.correctAerial({{1, Similarity{2, Eigen::Matrix3d::Identity(), {0, 0, 1}}}, {3, std::nullopt}});
  const auto points = map.points();
  ASSERT_EQ(points.size(), 2u) << "the last is off in itself";
  EXPECT_LT((points[0].position - Eigen::Vector3f(0, 4, 1)).norm(), 1e-6);
  EXPECT_LT((points[1].position - Eigen::Vector3f(0, 4, 0)).norm(), 1e-6);
  map.clearAerial();
  EXPECT_TRUE(map.points().empty());
}

// Whether somebody looks at each correction, or at the last alone, when older clouds have settled.
TEST(AugmentedMap, PointsAreTheSameHoweverOftenTheyWereAskedFor) {
  AugmentedMapSettings settings;
  settings.max_voxels = 400;  // they grow on the way
  AugmentedMap watched(settings), left_alone(settings);
  air_ground_common::CloudCorrections corrections;
  for (AugmentedMap* map : {&watched, &left_alone}) map->align(Similarity());
  for (std::int64_t stamp = 0; stamp < 130; ++stamp) {
    std::vector<LabeledPoint> cloud;
    for (int k = 0; k < 20; ++k) {
      const float x = 0.01f * static_cast<float>(stamp) + 0.03f * static_cast<float>(k % 5);
      cloud.push_back({{x, 0.05f * static_cast<float>(k / 5), 0}, {static_cast<std::uint8_t>(10 * k), 0, 0}, 1});
    }
    for (AugmentedMap* map : {&watched, &left_alone}) map->addAerial(stamp, cloud);
    corrections[stamp] = Similarity{1, Eigen::Matrix3d::Identity(), {0, 0, 0.001 * static_cast<double>(stamp % 7)}};
    if (stamp % 40 == 39)
      for (AugmentedMap* map : {&watched, &left_alone}) map->correctAerial(corrections);
    EXPECT_FALSE(watched.points().empty());
  }
  const auto expected = watched.points(), points = left_alone.points();
  ASSERT_EQ(points.size(), expected.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(points[i].position, expected[i].position);
    EXPECT_EQ(points[i].rgb, expected[i].rgb);
  }
}

TEST(AugmentedMap, FillsOnlyWhatTheGroundRobotDidNotSee) {
  AugmentedMapSettings settings;
  settings.fill_only = true;
  settings.ground_red = false;
  AugmentedMap map(settings);
  map.align(Similarity());
  map.setGround({{{0.01f, 0.01f, 0.01f}, {10, 20, 30}, 0}});
  map.addAerial(1, {{{0.03f, 0.01f, 0.01f}, {77, 77, 77}, 1}, {{1, 0, 0}, {77, 77, 77}, 1}});
  const auto points = map.points();
  ASSERT_EQ(points.size(), 2u);
  EXPECT_EQ(points[0].rgb[2], 30);
  EXPECT_NEAR(points[1].position.x(), 1, 1e-6);
}

}  // namespace
}  // namespace icp_refine
