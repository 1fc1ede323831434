// The pose follows when a robot corrects its map.
#include "refiner_fixture.h"

namespace icp_refine {
namespace {

// The MAV's map grows by 2 % about its origin and shifts; the ground robot's stays.
TEST_F(Refiner, FollowsACorrectionOfTheAerialMap) {
  refiner.setCoarse(moved(0.2, -0.1, 0.1, 0.06));
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  const Similarity S{1.02, Eigen::AngleAxisd(0.03, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {0.2, -0.1, 0.05}};
  refiner.correctAerial({{1, S}, {99, std::nullopt}});
  const auto errorNow = [&](const Similarity& T) {
    return (T * (S * centre) - scene.T_ground_map_mav_map * centre).norm();
  };
  EXPECT_LT(errorNow(*refiner.refined()), 0.08) << "at once";
  EXPECT_NEAR(refiner.refined()->scale, 1 / 1.02, 0.01);
  refiner.setScaleDeviation(0.02);
  const auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_TRUE(out.tracking);
  EXPECT_LT(errorNow(out.T_ground_map_mav_map), 0.08);

  refiner.correctAerial({{1, std::nullopt}});
  EXPECT_NE(refiner.refine().reason.find("aerial"), std::string::npos) << "a cloud that is off in itself goes";
  EXPECT_TRUE(refiner.tracking());
}

// The MAV flew 40 m on and drifted; an adjustment of its map takes the drift out, and leaves the overlap where it was.
TEST_F(Refiner, ACorrectionFarFromTheOverlapLeavesTheAlignmentThere) {
  refiner.setCoarse(moved(0.1, -0.1, 0.05, 0.03));
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  const Similarity aligned = *refiner.refined();
  Cloud far = scene.aerial;
  for (auto& p : far.points) p += Eigen::Vector3f(40, 0, 0);
  for (std::int64_t stamp = 2; stamp < 12; ++stamp) refiner.addAerial(stamp, far);
  const Similarity drift{1, Eigen::Matrix3d::Identity(), {0.8, 0.3, 0}};
  refiner.correctAerial({{1, Similarity()}, {10, drift}, {11, drift}});
  EXPECT_LT((*refiner.refined() * centre - aligned * centre).norm(), 1e-9);
  // The cloud that it was found with is not followed any longer: the newest ones tell.
  refiner.correctAerial({{11, drift}});
  EXPECT_LT((*refiner.refined() * (drift * centre) - aligned * centre).norm(), 1e-9);
}

// What converges on the map as it was shows nothing of the correction; what does on the next one does.
TEST_F(Refiner, AMovedGroundCountsUntilAPoseHasConvergedOnTheCorrectedMap) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  refiner.groundMoved();
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  EXPECT_TRUE(refiner.groundHasMoved());
  EXPECT_TRUE(refiner.unproven());
  for (int k = 0; k < 5; ++k) refiner.setGround(scene.ground);
  EXPECT_TRUE(refiner.groundHasMoved());
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  EXPECT_FALSE(refiner.groundHasMoved());
  EXPECT_FALSE(refiner.unproven());
}

// The ground robot closed a loop and parked before the MAV flew: no other ground map comes.
TEST_F(Refiner, AGroundThatMovedBeforeAnythingWasTrackedIsForgotten) {
  refiner.groundMoved();
  refiner.setGround(scene.ground);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kSearching) << "there is no guess";
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  for (std::int64_t stamp = 2; stamp < 5; ++stamp) {
    refiner.addAerial(stamp, scene.aerial);
    ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  }
  EXPECT_FALSE(refiner.groundHasMoved());
  Cloud shifted = scene.aerial;
  for (auto& p : shifted.points) p += Eigen::Vector3f(0.2f, 0, 0);
  for (std::int64_t stamp = 5; stamp < 11; ++stamp) refiner.addAerial(stamp, shifted);
  const auto out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kSearching) << out.reason;
  EXPECT_NE(out.reason.find("far from the last pose"), std::string::npos) << out.reason;
}

// The MAV scouted here, and flew on before the ground robot came.
TEST_F(Refiner, AGuessIsRefinedWithTheCloudsThatItPutsOnTheGroundMap) {
  Cloud far = scene.aerial;
  for (auto& p : far.points) p += Eigen::Vector3f(40, 0, 0);
  for (std::int64_t stamp = 2; stamp < 12; ++stamp) refiner.addAerial(stamp, far);
  refiner.setCoarse(moved(0.1, -0.1, 0.05, 0.03));
  auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(error(out.T_ground_map_mav_map), 0.08);
  EXPECT_LT(out.stamp, 7) << "of the six clouds with the one that was made here";
  // What is tracked is judged by where the MAV is now.
  refiner.addAerial(12, far);
  out = refiner.refine();
  EXPECT_NE(out.status, RefineStatus::kConverged);
  EXPECT_EQ(out.stamp, 12);
  EXPECT_LT(error(*refiner.refined()), 0.08);
}

/// The ground map after a loop closure that moves the overlap farther than ICP reaches.
class MovedGround : public Refiner {
 protected:
  MovedGround() : correction(Eigen::Translation3d(1.6, -1.1, 0) * Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitZ())) {
    refiner.setCoarse(scene.T_ground_map_mav_map);
    EXPECT_EQ(refiner.refine().status, RefineStatus::kConverged);
    refiner.groundMoved();
    refiner.setGround(transformed(scene.ground, correction));
    refiner.refine();
    EXPECT_TRUE(refiner.unproven());
  }
  double errorNow() const {
    return (*refiner.refined() * centre - correction * (scene.T_ground_map_mav_map * centre)).norm();
  }
  Pose correction;
};

TEST_F(MovedGround, IsFollowedFromTheFirstCoarsePoseThatComes) {
  refiner.setCoarse(correction * scene.T_ground_map_mav_map);
  const auto out = refiner.refine();  // no other cloud of the MAV has come
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(errorNow(), 0.08);
  EXPECT_FALSE(refiner.unproven());
}

TEST_F(MovedGround, IsFollowedWhereTheImagesTell) {
  KnownAlignment views;
  views.T_ground_map_mav_map = similarity(correction * scene.T_ground_map_mav_map);
  views.covariance = 1e-4 * Matrix6d::Identity();
  views.centre = correction * (scene.T_ground_map_mav_map * centre);
  refiner.setViews(views);
  const auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(errorNow(), 0.08);
}

// That was one before the loop closed: the pose is of the map as it was, and has come and gone.
TEST_F(Refiner, ACoarsePoseThatDisagreedBeforeTheGroundMovedIsNotTried) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  const Pose elsewhere(Eigen::Translation3d(1.6, -1.1, 0) * Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitZ()));
  refiner.setCoarse(elsewhere * scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  refiner.groundMoved();
  refiner.setGround(transformed(scene.ground, elsewhere));
  const auto out = refiner.refine();
  EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(out.instead);
  // Nor is a guess for that: what comes of it needs another cloud.
  refiner.setCoarse(elsewhere * scene.T_ground_map_mav_map, false);
  EXPECT_NE(refiner.refine().status, RefineStatus::kConverged);
}

TEST_F(MovedGround, IsTriedOnTwoMaps) {
  EXPECT_TRUE(refiner.groundHasMoved());
  refiner.refine();  // on the same map
  EXPECT_TRUE(refiner.groundHasMoved());
  refiner.setGround(transformed(scene.ground, correction));
  refiner.refine();
  EXPECT_FALSE(refiner.groundHasMoved());
}

TEST_F(MovedGround, EndsThePoseThatItContradicts) {
  int maps = 1;
  for (; maps < 8 && refiner.tracking(); ++maps) {
    refiner.setGround(transformed(scene.ground, correction));
    refiner.refine();
  }
  EXPECT_FALSE(refiner.tracking());
  EXPECT_GE(maps, RefinerSettings().lost_after);
}

}  // namespace
}  // namespace icp_refine
