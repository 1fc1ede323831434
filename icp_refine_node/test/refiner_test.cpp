// The decisions around the chain: which guess, tracking, loss, competition with the coarse pose.
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <random>

#include "icp_refine/alignment_refiner.h"
#include "synthetic_scene.h"

namespace icp_refine {
namespace {

class Refiner : public testing::Test {
 protected:
  Refiner()
      : scene(synthetic::makeScene(1)),
        refiner(IcpChain(YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]), {}) {
    refiner.setGround(scene.ground);
    refiner.addAerial(1, scene.aerial);
    centre = synthetic::centroid(scene.aerial);
  }

  Pose moved(double x, double y, double z, double yaw) const {
    const Eigen::Vector3d m = scene.T_ground_map_mav_map * centre;
    const Eigen::Matrix3d R = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    Pose D = Pose::Identity();
    D.linear() = R;
    D.translation() = m + Eigen::Vector3d(x, y, z) - R * m;
    return D * scene.T_ground_map_mav_map;
  }

  double error(const Similarity& T) const { return (T * centre - scene.T_ground_map_mav_map * centre).norm(); }

  synthetic::Scene scene;
  AlignmentRefiner refiner;
  Eigen::Vector3d centre;
};

TEST_F(Refiner, SaysWhatItWaitsFor) {
  EXPECT_NE(refiner.refine().reason.find("coarse"), std::string::npos);
  refiner.startMap();
  refiner.setCoarse(scene.T_ground_map_mav_map);
  EXPECT_NE(refiner.refine().reason.find("aerial"), std::string::npos);
  refiner.addAerial(2, Cloud{});
  EXPECT_NE(refiner.refine().reason.find("aerial"), std::string::npos);
  refiner.reset();
  refiner.setCoarse(scene.T_ground_map_mav_map);
  refiner.addAerial(3, scene.aerial);
  EXPECT_NE(refiner.refine().reason.find("ground"), std::string::npos);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kSearching);
}

TEST_F(Refiner, TracksFromTheLastRefinedPose) {
  refiner.setCoarse(moved(0.2, -0.1, 0.1, 0.06));
  auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(out.tracking);
  EXPECT_LT(error(out.T_ground_map_mav_map), 0.08);
  refiner.addAerial(2, scene.aerial);
  out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_TRUE(out.tracking);
  EXPECT_EQ(out.stamp, 2);
}

TEST_F(Refiner, RefinesWithTheNewestGroundMapHoweverEarlyItWasPrepared) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  const auto before = refiner.refine();
  ASSERT_EQ(before.status, RefineStatus::kConverged);
  const Eigen::Vector3d correction(0.06, -0.04, 0.02);  // of the ground map, twice
  Cloud ground = scene.ground;
  for (int corrections = 1; corrections <= 2; ++corrections) {
    for (auto& p : ground.points) p += correction.cast<float>();
    refiner.setGround(ground);
    refiner.prepareGround();
    const auto out = refiner.refine();
    ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
    const Eigen::Vector3d expected = before.T_ground_map_mav_map * centre + corrections * correction;
    EXPECT_LT((out.T_ground_map_mav_map * centre - expected).norm(), 0.01) << corrections;
  }
}

TEST_F(Refiner, WhatComesOfAGuessIsBelievedOnceAnotherCloudConfirmsIt) {
  const auto guess = [&](const Pose& T) {
    refiner.setCoarse(T, false);
    return refiner.refine();
  };
  const Pose wrong = moved(0.4, 0.3, 0, 2.4);
  RefineOutcome out = guess(moved(0.1, -0.1, 0, 0.05));
  EXPECT_EQ(out.status, RefineStatus::kSearching);
  EXPECT_NE(out.reason.find("confirms"), std::string::npos) << out.reason;
  EXPECT_FALSE(refiner.tracking());
  EXPECT_NE(refiner.refine().reason.find("waiting for a coarse alignment"), std::string::npos) << "one guess, one try";
  EXPECT_EQ(guess(moved(-0.1, 0.1, 0, -0.05)).status, RefineStatus::kSearching) << "the same cloud";
  EXPECT_NE(guess(wrong).status, RefineStatus::kConverged);
  refiner.addAerial(2, scene.aerial);
  out = guess(moved(-0.1, 0, 0, 0));
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(error(out.T_ground_map_mav_map), 0.08);
  EXPECT_TRUE(refiner.tracking());
}

TEST_F(Refiner, AGuessThatLedElsewhereConfirmsNothing) {
  refiner.setCoarse(scene.T_ground_map_mav_map, false);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kSearching);
  Cloud shifted = scene.ground;  // the maps fit 0.2 m from there now
  for (auto& p : shifted.points) p += Eigen::Vector3f(0.2f, 0, 0);
  refiner.setGround(shifted);
  refiner.addAerial(2, scene.aerial);
  refiner.setCoarse(moved(0.2, 0, 0, 0), false);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kSearching);
  refiner.addAerial(3, scene.aerial);
  refiner.setCoarse(moved(0.2, 0, 0, 0), false);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kConverged);
}

TEST_F(Refiner, AGuessDoesNotCompeteWithTheTrackedPose) {
  RefinerSettings settings;
  settings.coarse_disagreements = 1;
  AlignmentRefiner other(IcpChain(YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]), settings);
  other.setGround(scene.ground);
  other.addAerial(1, scene.aerial);
  other.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(other.refine().status, RefineStatus::kConverged);
  other.setCoarse(moved(0.8, 0.3, 0, 2.4), false);
  EXPECT_TRUE(other.refine().tracking);
}

TEST_F(Refiner, AGuessOnAPlaneGetsItsHeightFromTheMaps) {
  refiner.setManual(moved(0.1, 0.1, 1.3, 0.05));
  const auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(error(out.T_ground_map_mav_map), 0.08);
}

TEST_F(Refiner, AManualGuessReplacesTheTrackedPoseOnlyOnceItConverges) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  refiner.setManual(moved(0.4, 0.3, 0, 2.4));
  EXPECT_TRUE(refiner.tracking());
  auto out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_TRUE(out.tracking);
  EXPECT_NE(out.reason.find("manual"), std::string::npos) << out.reason;
  EXPECT_LT(error(*refiner.refined()), 0.08);
  refiner.setManual(moved(0.1, -0.1, 0, 0.05));
  out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(out.tracking);
  EXPECT_LT(error(*refiner.refined()), 0.08);
}

TEST_F(Refiner, AnotherGroundMapEndsThePoseNotTheAerialClouds) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  refiner.startGround();
  EXPECT_FALSE(refiner.tracking());
  refiner.setCoarse(scene.T_ground_map_mav_map);
  EXPECT_NE(refiner.refine().reason.find("ground"), std::string::npos);
  refiner.setGround(scene.ground);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kConverged);
}

TEST_F(Refiner, AWrongCoarsePoseIsRejectedAndNotTracked) {
  refiner.setCoarse(moved(0.4, 0.3, 0, 2.4));
  const auto out = refiner.refine();
  EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(refiner.tracking());
  EXPECT_FALSE(out.reason.empty());
  if (out.status == RefineStatus::kRejected) {
    EXPECT_GE(out.covariance.diagonal().minCoeff(), 1e6);
  }
}

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
  void seeAt(double x, double y) {
    views.T_ground_map_mav_map = similarity(Pose(Eigen::Translation3d(x, y, 0) * truth));
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
  const Eigen::Vector3d error =
      out.T_ground_map_mav_map * (truth.inverse() * out.reference_point) - out.reference_point;
  EXPECT_NEAR(error.x(), 0.02, 0.01);  // as the images say
  EXPECT_NEAR(error.y(), 0, 0.01);     // as the wall says
  EXPECT_NEAR(std::sqrt(out.covariance(0, 0)), 0.03, 0.015);
  EXPECT_LT(std::sqrt(out.covariance(1, 1)), std::sqrt(out.covariance(0, 0)));
}

/// The same with a box that both robots see, too small to fix what the wall leaves open.
class AlongAWallWithABox : public AlongAWall {
 protected:
  AlongAWallWithABox() : AlongAWall(true) {}
  KnownAlignment coarseAt(double x, double y) const {
    KnownAlignment coarse;
    coarse.T_ground_map_mav_map = similarity(Pose(Eigen::Translation3d(x, y, 0) * truth));
    coarse.centre = {0, 1, 0.5};
    coarse.covariance = 49e-4 * Matrix6d::Identity();
    coarse.covariance.bottomRightCorner<3, 3>() *= 0.2;
    coarse.scale_stddev = 0;
    return coarse;
  }
  double along(const RefineOutcome& out) const {
    return (out.T_ground_map_mav_map * (truth.inverse() * out.reference_point) - out.reference_point).x();
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
  const Eigen::Vector3d error =
      out.T_ground_map_mav_map * (truth.inverse() * out.reference_point) - out.reference_point;
  EXPECT_NEAR(error.x(), 0.02, 0.01);  // as the coarse alignment has it
  EXPECT_NEAR(error.y(), 0, 0.01);     // as the wall says
  EXPECT_NEAR(std::sqrt(out.covariance(0, 0)), 0.07, 0.02);
  EXPECT_LT(std::sqrt(out.covariance(1, 1)), 0.04);
  // What is known of the ground map before a loop closed is not of this one.
  refiner.groundMoved();
  refiner.addAerial(2, aerial);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kDegenerate);
  EXPECT_TRUE(refiner.tracking());
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
  EXPECT_NEAR(along(out), 0.16, 0.01);
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

TEST_F(Refiner, ViewsThatTheCloudsContradictAreNotTaken) {
  KnownAlignment views;
  views.T_ground_map_mav_map = similarity(moved(0.3, 0, 0, 0));
  views.covariance = 4e-4 * Matrix6d::Identity();
  views.centre = scene.T_ground_map_mav_map * centre;
  refiner.setViews(views);
  const RefineOutcome out = refiner.refine();
  EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_FALSE(refiner.tracking());
  refiner.setCoarse(scene.T_ground_map_mav_map);
  EXPECT_EQ(refiner.refine().status, RefineStatus::kConverged);
}

TEST_F(Refiner, WantOfOverlapKeepsThePoseContradictionsEndIt) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  // The MAV flies away: no overlap, nothing against the pose.
  Cloud away = scene.aerial;
  for (auto& p : away.points) p.x() += 30;
  for (int k = 0; k < 8; ++k) {
    refiner.addAerial(10 + k, away);
    if (k < 6) continue;  // the window still holds the first cloud
    EXPECT_NE(refiner.refine().status, RefineStatus::kConverged);
    EXPECT_TRUE(refiner.tracking());
  }
  // The world contradicts: another scene at the same place.
  const auto other = synthetic::makeScene(17);
  Cloud wrong = transformed(
      other.aerial, scene.T_ground_map_mav_map.inverse() * scene.T_world_ground_map.inverse() * other.T_world_mav_map);
  for (int k = 0; k < 6; ++k) refiner.addAerial(20 + k, wrong);
  for (int k = 0; k < 3; ++k) {
    ASSERT_TRUE(refiner.tracking());
    const auto out = refiner.refine();
    EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
  }
  EXPECT_FALSE(refiner.tracking());
}

TEST_F(Refiner, ACoarsePoseThatKeepsDisagreeingDoesNotReplaceABetterOne) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  for (int k = 0; k < 4; ++k) {
    refiner.setCoarse(moved(1.2, 0, 0, 1.5));
    EXPECT_EQ(refiner.refine().status, RefineStatus::kConverged);
    EXPECT_LT(error(*refiner.refined()), 0.08);
  }
}

TEST_F(Refiner, ACoarsePoseThatKeepsDisagreeingReplacesAWrongOne) {
  // Without the height check, and with normals that need not agree, a wrong place is believed, and tracked.
  RefinerSettings settings;
  settings.min_agreement = 0;
  settings.max_rms = 1;
  settings.max_sigma = settings.max_sigma_angle = 3;
  settings.coarse_distance = 0.3;
  YAML::Node chain = YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"];
  chain["levels"][2]["outlier_filters"][0]["NormalAngle"]["max"] = 0.6;
  AlignmentRefiner credulous(IcpChain(chain), settings);
  credulous.setGround(scene.ground);
  credulous.addAerial(1, scene.aerial);
  bool wrong = false;
  for (const Pose& guess : {moved(0.8, 0, 0, 0.5), moved(0, 0.8, 0, 0.5), moved(-0.8, 0, 0, 0.5),
                            moved(0, -0.8, 0, 0.5), moved(0, 0, 0, M_PI)}) {
    credulous.setManual(guess);
    const auto out = credulous.refine();
    wrong = out.status == RefineStatus::kConverged && error(out.T_ground_map_mav_map) > 0.4;
    if (wrong) break;
  }
  ASSERT_TRUE(wrong);
  for (int k = 0; k < settings.coarse_disagreements; ++k) {
    EXPECT_GT(error(*credulous.refined()), 0.3) << "switched after " << k;
    credulous.setCoarse(scene.T_ground_map_mav_map);
    credulous.refine();
  }
  EXPECT_LT(error(*credulous.refined()), 0.08);
}

TEST_F(Refiner, EstimatesTheScaleAndTracksIt) {
  synthetic::SceneSettings settings;
  settings.scale_error = settings.ground_drift = 0;
  settings.scale_offset = 0.02;
  settings.smooth_edges = false;
  scene = synthetic::makeScene(31, settings);
  centre = synthetic::centroid(scene.aerial);
  refiner.reset();
  refiner.setGround(scene.ground);
  refiner.addAerial(1, scene.aerial);
  refiner.setCoarse(moved(0.1, 0.1, 0, 0.04));
  auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_NEAR(out.T_ground_map_mav_map.scale, 1 / 1.02, 0.003);
  EXPECT_LT(out.scale_stddev, 0.006);
  EXPECT_NE(out.reason.find("scale 0.9"), std::string::npos) << out.reason;
  refiner.addAerial(2, scene.aerial);
  const int first = out.iterations;
  out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_TRUE(out.tracking);
  EXPECT_LT(out.iterations, first);
  // An odometry that is sure of its scale holds it, unless it says that it is not.
  RefinerSettings sure;
  sure.scale.stddev = 0.0005;
  AlignmentRefiner strict(IcpChain(YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/icp_refine.yaml")["chain"]), sure);
  for (const bool told : {false, true}) {
    strict.setGround(scene.ground);
    strict.addAerial(1, scene.aerial);
    if (told) strict.setScaleDeviation(0.02);
    strict.setCoarse(moved(0.1, 0.1, 0, 0.04));
    EXPECT_NEAR(strict.refine().T_ground_map_mav_map.scale, told ? 1 / 1.02 : 1, 0.004);
    strict.reset();
  }
}

// Maps are as parallel as both robots know their verticals; one that does not know leaves it to the clouds.
TEST_F(Refiner, HoldsTheTiltWhereBothRobotsKnowGravity) {
  const Pose lean(Eigen::AngleAxisd(0.03, Eigen::Vector3d::UnitX()));
  const Cloud leaning = transformed(scene.aerial, lean);
  for (const auto& [aerial, ground] : {std::pair{0.0, 0.0}, {0.002, 0.0}, {0.0, 0.002}, {0.002, 0.002}}) {
    refiner.reset();
    refiner.setGround(scene.ground);
    refiner.addAerial(1, leaning);
    refiner.setAerialVertical({Eigen::Vector3d::UnitZ(), aerial});
    refiner.setGroundVertical({Eigen::Vector3d::UnitZ(), ground});
    refiner.setCoarse(scene.T_ground_map_mav_map * lean.inverse());
    const auto out = refiner.refine();
    const double tilt = std::acos(out.T_ground_map_mav_map.R(2, 2));
    if (aerial > 0 && ground > 0)
      EXPECT_LT(tilt, 0.015) << out.reason;
    else
      EXPECT_NEAR(tilt, 0.03, 0.005) << out.reason;
  }
}

TEST_F(Refiner, AFlatFloorStaysDegenerateWhateverItsScale) {
  synthetic::SceneSettings settings;
  settings.world = synthetic::World::kFlat;
  settings.scale_offset = 0.02;
  scene = synthetic::makeScene(5, settings);
  refiner.reset();
  refiner.setGround(scene.ground);
  refiner.addAerial(1, scene.aerial);
  refiner.setCoarse(scene.T_ground_map_mav_map);
  const auto out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kDegenerate) << out.reason;
  EXPECT_EQ(out.T_ground_map_mav_map.scale, 1);
}

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

TEST(Similarity, InverseProductAndTheRigidTransformAtAPoint) {
  const Similarity T{1.7, air_ground_common::expSO3({0.3, -0.5, 1.1}), {1, 2, 3}};
  const Eigen::Vector3d p(0.4, -0.7, 2.5), q(5, 1, -2);
  EXPECT_LT((inverse(T) * (T * p) - p).norm(), 1e-12);
  EXPECT_LT((compose(T, inverse(T)) * p - p).norm(), 1e-12);
  EXPECT_LT((compose(T, T) * p - T * (T * p)).norm(), 1e-12);
  EXPECT_LT((rigidAt(T, p) * p - T * p).norm(), 1e-12);
  EXPECT_LT((T * q - T * p - 1.7 * (rigidAt(T, p) * q - rigidAt(T, p) * p)).norm(), 1e-12);
}

}  // namespace
}  // namespace icp_refine
