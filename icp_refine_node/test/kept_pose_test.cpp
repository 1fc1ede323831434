// Clouds that tell less of the pose than is known of it, or of another scale.
#include <algorithm>

#include "refiner_fixture.h"

namespace icp_refine {
namespace {

class FlyingOn : public Refiner {
 protected:
  FlyingOn() {
    refiner.setCoarse(scene.T_ground_map_mav_map);
    before = refiner.refine();
    // Within 0.8 m of here the geometry leaves a direction open.
    for (const auto& p : scene.aerial.points)
      if (std::abs(p.x() - centre.x()) < 0.8 && std::abs(p.y() - centre.y()) < 0.8) little.points.push_back(p);
  }
  /// All clouds that are refined show this.
  void see(const Cloud& cloud) {
    for (int k = 0; k < 8; ++k) refiner.addAerial(++stamp, cloud);
  }
  /// A coarse pose `offset` beside the truth, 10 cm sure.
  void hearOf(const Eigen::Vector2d& offset) {
    KnownAlignment coarse = viewsAt(moved(offset.x(), offset.y(), 0, 0));
    coarse.covariance.topLeftCorner<3, 3>() = 0.1 * 0.1 * Eigen::Matrix3d::Identity();
    refiner.setCoarse(coarse);
  }

  RefineOutcome before;
  Cloud little;
  std::int64_t stamp = 1;
};

TEST_F(FlyingOn, ThePoseIsKeptWhereTheCoarseOneWouldHoldItWorse) {
  ASSERT_EQ(before.status, RefineStatus::kConverged) << before.reason;
  see(little);
  hearOf({0.05, 0.03});
  const RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  ASSERT_FALSE(out.icp.localizability.complete());
  EXPECT_TRUE(out.kept);
  EXPECT_EQ(out.stamp, stamp);
  EXPECT_LT((out.T_ground_map_mav_map * centre - before.T_ground_map_mav_map * centre).norm(), 1e-9);
  EXPECT_EQ(out.T_ground_map_mav_map.scale, before.T_ground_map_mav_map.scale);
  EXPECT_GE(positionStddev(out.covariance), positionStddev(before.covariance));
  EXPECT_LT(positionStddev(out.covariance), 1.5 * positionStddev(before.covariance));
}

TEST_F(FlyingOn, ButNotOnAGroundMapThatHasMoved) {
  see(little);
  refiner.groundMoved();
  hearOf({0.05, 0.03});
  EXPECT_FALSE(refiner.refine().kept);
}

// Floor where the ground robot has seen boxes: nothing fixes where ICP ends, and no place near the pose is right.
TEST_F(FlyingOn, WhatContradictsThePoseItselfEndsItHoweverOpenTheGeometryIs) {
  for (int k = 0; k < 5; ++k) {
    see(little);
    const RefineOutcome out = refiner.refine();
    ASSERT_FALSE(out.icp.localizability.complete());
    EXPECT_FALSE(out.contradicted) << out.reason;
  }
  ASSERT_TRUE(refiner.tracking());
  Cloud flat = scene.aerial;
  std::vector<float> heights;
  for (const auto& p : flat.points) heights.push_back(p.z());
  std::nth_element(heights.begin(), heights.begin() + heights.size() / 4, heights.end());
  for (auto& p : flat.points) p.z() = heights[heights.size() / 4];
  for (int k = 1; k <= 3; ++k) {
    ASSERT_TRUE(refiner.tracking()) << k;
    see(flat);
    const RefineOutcome out = refiner.refine();
    ASSERT_FALSE(out.icp.localizability.complete());
    EXPECT_EQ(out.lost, k == 3) << k << " " << out.reason;
  }
  EXPECT_FALSE(refiner.tracking());
}

TEST_F(FlyingOn, CloudsThatTellAsMuchReplaceIt) {
  const Eigen::Vector3d drift(0.04, -0.03, 0);  // of the odometry
  Cloud drifted = scene.aerial;
  for (auto& p : drifted.points) p += drift.cast<float>();
  see(drifted);
  const RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(out.kept);
  EXPECT_LT((out.T_ground_map_mav_map * (centre + drift) - before.T_ground_map_mav_map * centre).norm(), 0.01);
}

// What was seen lies where it did, at another size.
TEST_F(Refiner, ALeapOfTheScaleIsBelievedOnceAnotherCloudConfirmsIt) {
  refiner.setScaleDeviation(0.05);
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  const double before = refiner.refined()->scale;
  Similarity larger{1.07, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
  larger.t = centre - larger.scale * centre;
  const Cloud grown = transformed(scene.aerial, larger);
  for (std::int64_t stamp = 2; stamp < 8; ++stamp) refiner.addAerial(stamp, grown);
  RefineOutcome out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kSearching) << out.reason;
  EXPECT_NE(out.reason.find("far from the last pose"), std::string::npos) << out.reason;
  EXPECT_EQ(refiner.refined()->scale, before);
  refiner.addAerial(8, grown);
  out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_NEAR(refiner.refined()->scale, before / larger.scale, 0.01);
}

}  // namespace
}  // namespace icp_refine
