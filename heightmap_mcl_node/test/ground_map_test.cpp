// What the localizer makes of ground maps that come late, change, or hold nothing.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"
#include "heightmap_mcl/localizer.h"
#include "synthetic_world.h"

namespace heightmap_mcl {
namespace {

synthetic::Run runOf(int aerial_clouds) {
  synthetic::Options options;
  options.seed = 505;
  options.aerial_clouds = aerial_clouds;
  return synthetic::makeRun(options);
}

TEST(GroundMap, OrderOfMapsDoesNotMatterAndMissingOnesAreNamed) {
  const synthetic::Run run = runOf(4);
  HeightMapLocalizer localizer({});
  EXPECT_FALSE(localizer.estimate().has_pose);
  EXPECT_NE(localizer.estimate().reason.find("ground"), std::string::npos);
  for (const auto& cloud : run.aerial) localizer.addAerial(cloud);
  EXPECT_EQ(localizer.estimate().status, Status::kSearching);
  localizer.setGround(run.ground);
  EXPECT_TRUE(localizer.estimate().has_pose);
  const auto error =
      synthetic::errorOf(localizer.estimate().T_ground_mav, run.T_ground_mav.back(), run.aerial.back().reference);
  EXPECT_LT(error.position, 0.2);
  // Losing the ground map, or getting an empty one, takes the pose back.
  EXPECT_FALSE(localizer.setGround({}));
  EXPECT_FALSE(localizer.estimate().has_pose);
  localizer.setGround(run.ground);
  localizer.restart(true);
  EXPECT_FALSE(localizer.estimate().has_pose);
  EXPECT_NE(localizer.estimate().reason.find("aerial"), std::string::npos);
}

TEST(GroundMap, AConvergedEstimateHoldsUntilTheGroundMapChanges) {
  const synthetic::Run run = runOf(6);
  HeightMapLocalizer localizer({});
  ASSERT_TRUE(localizer.setGround(run.ground));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(localizer.addAerial(cloud));
  ASSERT_EQ(localizer.estimate().status, Status::kConverged) << localizer.estimate().reason;
  const auto moved = [&run](double yaw, const Eigen::Vector3d& shift) {
    const air_ground_common::Pose T = air_ground_common::yawPose(yaw, shift);
    std::vector<Eigen::Vector3f> points;
    for (const auto& p : run.ground) points.push_back((T * p.cast<double>()).cast<float>());
    return points;
  };
  const auto errorFor = [&](const air_ground_common::Pose& T) {
    return synthetic::errorOf(localizer.estimate().T_ground_mav, T * run.T_ground_mav.back(),
                              run.aerial.back().reference);
  };
  // The same map, levelled anew by less than a cell: the same estimate, not another search.
  const air_ground_common::Pose before = localizer.estimate().T_ground_mav;
  ASSERT_TRUE(localizer.setGround(moved(0, {0.004, 0, 0})));
  EXPECT_EQ(localizer.estimate().status, Status::kConverged);
  EXPECT_TRUE(localizer.estimate().T_ground_mav.isApprox(before, 0));
  // The ground robot says that it was corrected: another search.
  ASSERT_TRUE(localizer.setGround(moved(0, {0.004, 0, 0}), nullptr, true));
  EXPECT_EQ(localizer.estimate().status, Status::kConverged);
  EXPECT_FALSE(localizer.estimate().T_ground_mav.isApprox(before, 0));
  // Corrected as a whole, by more than any descent reaches from the place of before.
  const Eigen::Vector3d shift(1.5, -0.8, 0);
  ASSERT_TRUE(localizer.setGround(moved(0.5, shift)));
  EXPECT_LT(errorFor(air_ground_common::yawPose(0.5, shift)).position, 0.2);
  // A second, equal place comes into view.
  std::vector<Eigen::Vector3f> twice = run.ground;
  const std::vector<Eigen::Vector3f> other = moved(0, {0, 20, 0});
  twice.insert(twice.end(), other.begin(), other.end());
  ASSERT_TRUE(localizer.setGround(twice));
  EXPECT_EQ(localizer.estimate().status, Status::kAmbiguous) << localizer.estimate().reason;
}

TEST(GroundMap, OneThatComesAfterTheLastCloudIsEnough) {
  for (const std::uint32_t seed : {511, 512}) {
    synthetic::Options options;
    options.seed = seed;
    options.aerial_clouds = 6;
    const synthetic::Run run = synthetic::makeRun(options);
    HeightMapLocalizer localizer({});
    for (const auto& cloud : run.aerial) ASSERT_TRUE(localizer.addAerial(cloud));
    // Of another world first: nothing of it may be left.
    options.seed = seed + 100;
    ASSERT_TRUE(localizer.setGround(synthetic::makeRun(options).ground));
    EXPECT_NE(localizer.estimate().status, Status::kConverged) << localizer.estimate().reason;
    std::vector<Eigen::Vector3f> part;
    for (const auto& p : run.ground)
      if (p.x() < run.ground.front().x()) part.push_back(p);
    localizer.setGround(part);
    ASSERT_TRUE(localizer.setGround(run.ground));
    const CoarseEstimate& e = localizer.estimate();
    EXPECT_EQ(e.status, Status::kConverged) << seed << ": " << e.reason;
    const auto error = synthetic::errorOf(e.T_ground_mav, run.T_ground_mav.back(), run.aerial.back().reference);
    EXPECT_LT(error.position, 0.1);
    // The same again says nothing new; and a person who asks for another search gets the same answer.
    const double evidence = e.evidence;
    ASSERT_TRUE(localizer.setGround(run.ground));
    EXPECT_EQ(localizer.estimate().evidence, evidence);
    localizer.restart(false);
    EXPECT_EQ(localizer.estimate().status, Status::kConverged) << seed << ": " << localizer.estimate().reason;
  }
}

HeightMapLocalizerSettings inCellsOf(double resolution) {
  HeightMapLocalizerSettings settings;
  settings.air_map.resolution = settings.ground_map.resolution = resolution;
  settings.coarse_factor = 2;
  return settings;
}

/// A MAV that has landed after four clouds over what the ground robot has mapped badly.
struct Landed {
  explicit Landed(std::uint64_t seed) : localizer(inCellsOf(0.04)) {
    synthetic::Options options;
    options.seed = seed;
    options.aerial_clouds = 4;
    run = synthetic::makeRun(options);
    EXPECT_TRUE(localizer.setGround(synthetic::drifted(run.ground)));
    for (const auto& cloud : run.aerial) EXPECT_TRUE(localizer.addAerial(cloud));
    EXPECT_NE(localizer.estimate().status, Status::kConverged) << seed;
  }

  void expectConverged() const {
    const CoarseEstimate& e = localizer.estimate();
    EXPECT_EQ(e.status, Status::kConverged) << e.reason;
    const auto error = synthetic::errorOf(e.T_ground_mav, run.T_ground_mav.back(), run.aerial.back().reference);
    EXPECT_LT(error.position, 0.15);
  }

  synthetic::Run run;
  HeightMapLocalizer localizer;
};

// It has about as many cells as before, but the place that was not believed agrees better.
TEST(GroundMap, AClosedLoopIsSeenInHowThePlaceAgrees) {
  Landed mav(503);
  ASSERT_TRUE(mav.localizer.setGround(mav.run.ground));
  mav.expectConverged();
}

// Evidence for a guess, gathered in the map of before, does not keep the clouds from being heard once more.
TEST(GroundMap, AGuessMayBecomeMoreAfterTheLastCloud) {
  Landed mav(505);
  EXPECT_EQ(mav.localizer.estimate().evidence, 0);
  EXPECT_GT(mav.localizer.estimate().guess_evidence, 0);
  // The loop is closed, and bare floor beside comes in view.
  std::vector<Eigen::Vector3f> ground = mav.run.ground;
  Eigen::Vector3f right = ground.front();
  for (const auto& p : ground)
    if (p.x() > right.x()) right = p;
  std::vector<float> heights;
  for (const auto& p : ground) heights.push_back(p.z());
  const auto floor = heights.begin() + static_cast<std::ptrdiff_t>(heights.size() / 3);
  std::nth_element(heights.begin(), floor, heights.end());
  for (float x = 0.5; x < 3.5; x += 0.03f)
    for (float y = 0; y < 2.6; y += 0.03f) ground.emplace_back(right.x() + x, right.y() + y, *floor);
  ASSERT_TRUE(mav.localizer.setGround(ground));
  mav.expectConverged();
}

TEST(GroundMap, AGroundMapWithoutACellIsForgottenWhole) {
  const synthetic::Run run = runOf(2);
  HeightMapLocalizerSettings settings;
  settings.ground_map.min_points = 2;
  HeightMapLocalizer localizer(settings);
  EXPECT_FALSE(localizer.setGround({{0, 0, 0}, {1, 0, 0.2f}, {0, 1, 0.1f}}));
  EXPECT_FALSE(localizer.hasGround());
  ASSERT_TRUE(localizer.addAerial(run.aerial[0]));
  EXPECT_NE(localizer.estimate().reason.find("ground"), std::string::npos);
}

}  // namespace
}  // namespace heightmap_mcl
