#include "heightmap_mcl/earlier_clouds.h"

#include <gtest/gtest.h>

#include "synthetic_world.h"

namespace heightmap_mcl {
namespace {

using air_ground_common::Similarity;

/// A MAV that scouted a scene, and flew on for ten clouds before the ground robot came there.
class Scout : public testing::Test {
 protected:
  Scout() : earlier(HeightMapLocalizerSettings()) {
    synthetic::Options options;
    options.seed = 4;
    options.aerial_clouds = 10;
    run = synthetic::makeRun(options);
    options.seed = 9;
    const synthetic::Run other = synthetic::makeRun(options);
    for (const AerialCloud& cloud : run.aerial) add(cloud);
    for (AerialCloud cloud : other.aerial) {
      const Eigen::Vector3d away(60, 0, 0);
      for (auto& p : cloud.points) p += away.cast<float>();
      cloud.reference += away;
      add(cloud);
    }
  }

  void add(AerialCloud cloud, bool searched = true) {
    cloud.stamp = ++stamp;
    earlier.add(std::move(cloud), searched);
  }

  /// Until a group is found, or none is left.
  std::optional<EarlierClouds::Found> search() {
    for (steps = 0; earlier.pending(); ++steps)
      if (auto found = earlier.step()) return found;
    return std::nullopt;
  }

  void setGround(std::size_t cells) { earlier.setGround(run.ground, cells); }

  synthetic::Run run;
  EarlierClouds earlier;
  std::int64_t stamp = 0;
  int steps = 0;
};

TEST_F(Scout, IsFoundWhereItWasBefore) {
  EXPECT_FALSE(earlier.pending()) << "no ground map";
  setGround(10000);
  const auto found = search();
  ASSERT_TRUE(found);
  const auto k = static_cast<std::size_t>(found->stamp - 1);
  ASSERT_LT(k, run.aerial.size());
  EXPECT_EQ(found->reference, run.aerial[k].reference);
  const auto error = synthetic::errorOf(found->estimate.T_ground_mav, run.T_ground_mav[k], found->reference);
  EXPECT_LT(error.position, 0.25);
  EXPECT_LT(error.yaw, 5 * M_PI / 180);
  EXPECT_FALSE(earlier.pending());
  setGround(10500);
  EXPECT_FALSE(earlier.pending()) << "the ground map is about the same";
  setGround(12000);
  EXPECT_TRUE(earlier.pending());
}

TEST_F(Scout, FollowsCorrectionsOfItsMap) {
  const Similarity S{1, Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {3, -2, 0.1}};
  air_ground_common::CloudCorrections corrections;
  for (std::int64_t k = 1; k <= static_cast<std::int64_t>(run.aerial.size()); ++k) corrections[k] = S;
  earlier.correct(corrections);
  earlier.correct(corrections);  // said again, it has happened once
  setGround(10000);
  const auto found = search();
  ASSERT_TRUE(found);
  const auto k = static_cast<std::size_t>(found->stamp - 1);
  EXPECT_LT((found->reference - S * run.aerial[k].reference).norm(), 1e-9);
  const Eigen::Vector3d p = run.T_ground_mav[k] * run.aerial[k].reference;
  EXPECT_LT((found->estimate.T_ground_mav * found->reference - p).head<2>().norm(), 0.25);
  // Bent, they are off in themselves.
  for (auto& [bent, correction] : corrections) correction.reset();
  earlier.correct(corrections);
  setGround(20000);
  EXPECT_FALSE(search());
}

// It has as many cells as before.
TEST_F(Scout, IsFoundWhereALoopOfTheGroundMapWasClosed) {
  const std::vector<Eigen::Vector3f> closed = run.ground;
  run.ground = synthetic::drifted(closed);
  setGround(10000);
  EXPECT_FALSE(search());
  run.ground = closed;
  earlier.setGround(closed, 10000, true);
  EXPECT_TRUE(search());
}

TEST_F(Scout, IsSearchedAgainInASmallerGroundMap) {
  setGround(10000);
  ASSERT_TRUE(search());
  setGround(9500);
  EXPECT_FALSE(earlier.pending()) << "about the same";
  setGround(9000);
  EXPECT_TRUE(earlier.pending());
}

// Clouds that came faster than HeightMapLocalizer takes them.
TEST_F(Scout, CloudsThatNobodySearchedAreSearched) {
  setGround(10000);
  ASSERT_TRUE(search());
  for (const AerialCloud& cloud : run.aerial) add(cloud);
  EXPECT_FALSE(earlier.pending()) << "HeightMapLocalizer has had them";
  for (const AerialCloud& cloud : run.aerial) add(cloud, false);
  EXPECT_TRUE(earlier.pending());
  setGround(10000);
  EXPECT_TRUE(earlier.pending()) << "nor has it now";
}

TEST_F(Scout, SearchesNothingElsewhereTwice) {
  synthetic::Options options;
  options.seed = 23;
  run.ground = synthetic::makeRun(options).ground;
  setGround(10000);
  EXPECT_FALSE(search());
  EXPECT_GT(steps, 8);
  EXPECT_LT(steps, 40) << "of 20 clouds in groups of eight";
  setGround(10000);
  EXPECT_FALSE(earlier.pending());
  earlier.setPrior({});
  EXPECT_TRUE(earlier.pending());
  earlier.forgetAerial();
  EXPECT_FALSE(earlier.pending());
}

}  // namespace
}  // namespace heightmap_mcl
