// Directions that the geometry does not fix: what the images and the coarse alignment tell of them.
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <random>

#include "icp_refine/alignment_refiner.h"

namespace icp_refine {
namespace {

/// Floor and one wall along x: nothing tells where along the wall the MAV was.
class AlongAWall : public testing::Test {
 protected:
  explicit AlongAWall(bool with_box = false)
      : refiner(IcpChain(YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]), {}) {
    std::mt19937 random(3);
    std::normal_distribution<float> noise(0, 0.005f);
    const auto scan = [&](float from, float to) {
      Cloud cloud;
      for (float x = from; x < to; x += 0.03f) {
        for (float y = 0; y < 2; y += 0.03f) cloud.points.emplace_back(x, y, noise(random));
        for (float z = 0; z < 1.5f; z += 0.03f) cloud.points.emplace_back(x, 2 + noise(random), z);
      }
      for (float x = -0.6f; with_box && x < 0.6f; x += 0.03f)
        for (float y = 0.6f; y < 1.2f; y += 0.03f) cloud.points.emplace_back(x, y, 0.3f + noise(random));
      return cloud;
    };
    refiner.setGround(scan(-3, 3));
    aerial = transformed(scan(-1.5, 1.5), truth.inverse());
    refiner.addAerial(1, aerial);
    views.centre = {0, 1, 0.5};
    views.covariance = 9e-4 * Matrix6d::Identity();
    views.covariance.bottomRightCorner<3, 3>() *= 0.1;
  }
  Similarity beside(double x, double y) const { return similarity(Pose(Eigen::Translation3d(x, y, 0) * truth)); }
  Eigen::Vector3d error(const RefineOutcome& out) const {
    return out.T_ground_map_mav_map * (truth.inverse() * out.reference_point) - out.reference_point;
  }
  void seeAt(double x, double y) {
    views.T_ground_map_mav_map = beside(x, y);
    refiner.setViews(views);
  }

  Pose truth = air_ground_common::yawPose(0.7, {1, 2, 0.1});  // T_ground_map_mav_map
  AlignmentRefiner refiner;
  KnownAlignment views;
  Cloud aerial;
};

TEST_F(AlongAWall, TheCloudsAloneAreDegenerate) {
  refiner.setCoarse(truth);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kDegenerate);
}

TEST_F(AlongAWall, ViewsTellWhatTheGeometryLeavesOpen) {
  seeAt(0.02, 0.05);
  const RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_TRUE(out.seen);
  EXPECT_NEAR(error(out).x(), 0.02, 0.01);  // as the images say
  EXPECT_NEAR(error(out).y(), 0, 0.01);     // as the wall says
  EXPECT_NEAR(std::sqrt(out.covariance(0, 0)), 0.03, 0.015);
  EXPECT_LT(std::sqrt(out.covariance(1, 1)), std::sqrt(out.covariance(0, 0)));
}

TEST_F(AlongAWall, TheResultIsPutWhereTheImagesHaveIt) {
  seeAt(0, 0);
  refiner.setManual(poseOf(beside(0.07, 0)));  // along the wall, where ICP stays as it began
  const RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_NEAR(error(out).x(), 0, 0.01);
}

TEST_F(AlongAWall, WhatRestsOnImagesEndsWithThem) {
  seeAt(0, 0);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  ASSERT_TRUE(refiner.tracking());
  refiner.withdrawViews();
  EXPECT_FALSE(refiner.tracking());
}

/// The same with a box that both robots see, too small to fix what the wall leaves open.
class AlongAWallWithABox : public AlongAWall {
 protected:
  AlongAWallWithABox() : AlongAWall(true) {}
  KnownAlignment coarseAt(double x, double y) const {
    KnownAlignment coarse;
    coarse.T_ground_map_mav_map = beside(x, y);
    coarse.centre = {0, 1, 0.5};
    coarse.covariance = 49e-4 * Matrix6d::Identity();
    coarse.covariance.bottomRightCorner<3, 3>() *= 0.2;
    coarse.scale_stddev = 0;
    return coarse;
  }
};

TEST_F(AlongAWallWithABox, TheCoarsePoseHoldsWhatTheGeometryLeavesOpen) {
  refiner.setCoarse(poseOf(coarseAt(0.02, 0.05).T_ground_map_mav_map));
  EXPECT_EQ(refiner.refine().status, RefineStatus::kDegenerate);
  refiner.setCoarse(coarseAt(0.02, 0.05));
  const RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_TRUE(out.held);
  EXPECT_NE(out.reason.find("translation along x"), std::string::npos) << out.reason;
  EXPECT_NEAR(error(out).x(), 0.02, 0.01);  // as the coarse alignment has it
  EXPECT_NEAR(error(out).y(), 0, 0.01);     // as the wall says
  EXPECT_NEAR(std::sqrt(out.covariance(0, 0)), 0.07, 0.02);
  EXPECT_LT(std::sqrt(out.covariance(1, 1)), 0.04);
  // What is known of the ground map before a loop closed is not of this one.
  refiner.groundMoved();
  refiner.addAerial(2, aerial);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kDegenerate);
  EXPECT_TRUE(refiner.tracking());
}

// A metric map: the coarse stage states no scale, and was right 6 m from here.
TEST_F(AlongAWallWithABox, TheCoarsePoseIsHeldAsSurelyAsTheScaleIsKnown) {
  constexpr double kTooLarge = 1.015;
  const Cloud too_large = transformed(aerial, Similarity{kTooLarge, Eigen::Matrix3d::Identity(), {0, 0, 0}});
  refiner.startMap();
  refiner.addAerial(1, too_large);
  KnownAlignment coarse = coarseAt(0, 0);
  coarse.centre.x() = -6;
  Similarity& T = coarse.T_ground_map_mav_map;
  T.t = coarse.centre - T.R * (kTooLarge * (truth.inverse() * coarse.centre));
  refiner.setCoarse(coarse);
  const RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  ASSERT_TRUE(out.held);
  const Eigen::Vector3d true_point = kTooLarge * (truth.inverse() * out.reference_point);
  const double error_x = (out.T_ground_map_mav_map * true_point - out.reference_point).x();
  EXPECT_GT(std::abs(error_x), 0.08) << "by the scale along the way";
  EXPECT_LT(std::abs(error_x), std::sqrt(out.covariance(0, 0)));
}

TEST(KnownAlignment, WhereTheGeometryFixesNothingTheResultIsMovedThere) {
  KnownAlignment known;
  known.T_ground_map_mav_map = similarity(air_ground_common::yawPose(0.7, {1, 2, 0.1}));
  IcpResult icp;
  icp.centre = {3, -1, 0.5};
  icp.T_reference_reading = similarity(air_ground_common::yawPose(0.8, {1.1, 2.2, 0.15}));
  icp.localizability.mean_range = 2;
  for (int k = 0; k < 6; ++k) icp.localizability.directions[k].v = Vector6d::Unit(k);
  const Similarity all = heldAt(known, icp);
  EXPECT_LT((all.R - known.T_ground_map_mav_map.R).norm(), 1e-9);
  EXPECT_LT((all.t - known.T_ground_map_mav_map.t).norm(), 1e-9);
  // Heading fixed: about ICP's centre it stays.
  icp.localizability.directions[5].localizable = true;
  const Similarity shifted = heldAt(known, icp);
  EXPECT_LT((shifted.R - icp.T_reference_reading.R).norm(), 1e-9);
  const Eigen::Vector3d p_mav = inverse(icp.T_reference_reading) * icp.centre;
  EXPECT_LT((shifted * p_mav - known.T_ground_map_mav_map * p_mav).norm(), 1e-9);
}

TEST_F(AlongAWallWithABox, ATrackedPoseThatTheCoarseOneContradictsIsNotHeldByIt) {
  refiner.setCoarse(coarseAt(0.02, 0));
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  refiner.addAerial(2, aerial);
  refiner.setCoarse(coarseAt(0.16, 0));  // two sigma
  RefineOutcome out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_NEAR(error(out).x(), 0.16, 0.01);
  refiner.addAerial(3, aerial);
  refiner.setCoarse(coarseAt(0.41, 0));  // three and a half from there
  out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kDegenerate) << out.reason;
  EXPECT_FALSE(out.held);
}

TEST_F(AlongAWallWithABox, ACoarsePoseThatTheWallContradictsHoldsNothing) {
  refiner.setCoarse(coarseAt(0, 0.5));
  const RefineOutcome out = refiner.refine();
  EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(out.held);
  EXPECT_FALSE(refiner.tracking());
}

TEST_F(AlongAWall, ViewsThatTheWallContradictsAreNotTaken) {
  seeAt(0, 0.3);
  const RefineOutcome out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kDegenerate) << out.reason;
  EXPECT_FALSE(out.seen);
  EXPECT_FALSE(refiner.tracking());
}

TEST_F(AlongAWall, ViewsFiveSigmasAwayAreNotTaken) {
  seeAt(0, 0.22);
  const RefineOutcome out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kDegenerate) << out.reason;
  EXPECT_GT(out.view_sigmas, 4.5);
  EXPECT_LT(out.view_sigmas, 5.8);
}

}  // namespace
}  // namespace icp_refine
