// The decisions around the chain: which guess, tracking, loss, competition with the coarse pose.
#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <utility>

#include "refiner_fixture.h"

namespace icp_refine {
namespace {

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
  EXPECT_GE(out.covariance.diagonal().minCoeff(), 1e6);
  EXPECT_EQ(out.scale_stddev, 0);
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

// The MAV has landed and sends no more clouds; the ground robot drives on.
TEST_F(Refiner, WhatComesOfAGuessIsBelievedOnceTheGroundMapShowsMore) {
  const Eigen::Vector3f middle = (scene.T_ground_map_mav_map * centre).cast<float>();
  const auto groundWithin = [&](float reach) {
    Cloud part;
    for (const auto& p : scene.ground.points)
      if (p.x() < middle.x() + reach) part.points.push_back(p);
    return part;
  };
  const auto guessOn = [&](const Cloud& ground) {
    refiner.setGround(ground);
    refiner.setCoarse(moved(0.1, -0.1, 0, 0.05), false);
    return refiner.refine();
  };
  RefineOutcome out = guessOn(groundWithin(0.3f));
  const int seen = out.heights.relief_cells;
  ASSERT_EQ(out.status, RefineStatus::kSearching) << out.reason;
  out = guessOn(groundWithin(0.35f));
  EXPECT_LT(out.heights.relief_cells, 1.25 * seen);
  EXPECT_EQ(out.status, RefineStatus::kSearching) << "hardly more than before";
  out = guessOn(scene.ground);
  ASSERT_GE(out.heights.relief_cells, 1.25 * seen);
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(error(out.T_ground_map_mav_map), 0.08);
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

TEST_F(Refiner, ViewsThatTheCloudsContradictAreNotTaken) {
  refiner.setViews(viewsAt(moved(0.3, 0, 0, 0)));
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
    refiner.addAerial(30 + k, wrong);
    for (int again = 0; again < 3; ++again) {  // a correction of the map, or a person who asks: the same clouds
      ASSERT_TRUE(refiner.tracking());
      const auto out = refiner.refine();
      EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
      if (k == 2) break;
    }
  }
  EXPECT_FALSE(refiner.tracking());
}

// What stood on the floor when the MAV flew over has gone when the ground robot comes by.
TEST_F(Refiner, WhatHasMovedDoesNotEndAPoseThatImagesHold) {
  // Columns of 6 cm where the ground robot saw floor and nothing on it.
  std::map<std::pair<int, int>, float> tops;
  const auto columnOf = [](const Eigen::Vector3f& p) {
    return std::pair(static_cast<int>(std::floor(p.x() / 0.06f)), static_cast<int>(std::floor(p.y() / 0.06f)));
  };
  for (const auto& p : scene.ground.points) {
    const auto [it, is_new] = tops.emplace(columnOf(p), p.z());
    if (!is_new) it->second = std::max(it->second, p.z());
  }
  const Eigen::Affine3f to_ground(scene.T_ground_map_mav_map.cast<float>());
  const auto floorAround = [&](std::pair<int, int> middle, float z) {
    for (int x = -3; x <= 3; ++x) {
      for (int y = -3; y <= 3; ++y) {
        const auto it = tops.find({middle.first + x, middle.second + y});
        if (it == tops.end() || std::abs(it->second - z) > 0.08f) return false;
      }
    }
    return true;
  };
  const auto withThings = [&](std::size_t count) {
    Cloud out = scene.aerial;
    std::size_t made = 0;
    for (std::size_t i = 0; i < scene.aerial.size() && made < count; i += 23) {
      const Eigen::Vector3f p = to_ground * scene.aerial.points[i];
      if (!floorAround(columnOf(p), p.z())) continue;
      for (int x = -6; x <= 6; ++x)
        for (int y = -6; y <= 6; ++y)
          out.points.push_back(to_ground.inverse() * (p + Eigen::Vector3f(0.02f * x, 0.02f * y, 0.5f)));
      ++made;
    }
    EXPECT_EQ(made, count);
    return out;
  };
  const KnownAlignment views = viewsAt(scene.T_ground_map_mav_map);
  const auto tracksOn = [&](std::size_t things, bool with_views) {
    refiner.startMap();
    refiner.addAerial(1, scene.aerial);
    refiner.setCoarse(scene.T_ground_map_mav_map);
    EXPECT_EQ(refiner.refine().status, RefineStatus::kConverged);
    if (with_views) refiner.setViews(views);
    const Cloud moved_things = withThings(things);
    RefineOutcome out;
    for (int k = 0; k < 10; ++k) refiner.addAerial(10 + k, moved_things);
    for (int k = 0; k < 4 && refiner.tracking(); ++k) {
      refiner.addAerial(20 + k, moved_things);
      out = refiner.refine();
      EXPECT_NE(out.status, RefineStatus::kConverged) << out.reason;
    }
    return refiner.tracking();
  };
  EXPECT_FALSE(tracksOn(25, false));
  EXPECT_TRUE(tracksOn(25, true));
  EXPECT_FALSE(tracksOn(65, true)) << "hardly anything is where it was";
}

TEST_F(Refiner, ViewsThatAreWithdrawnStartNothing) {
  const KnownAlignment views = viewsAt(scene.T_ground_map_mav_map);
  const auto ended_by = [&](const std::function<void()>& event) {
    refiner.setViews(views);
    event();
    refiner.addAerial(5, scene.aerial);
    return refiner.refine().reason == "waiting for a coarse alignment or a manual guess";
  };
  EXPECT_TRUE(ended_by([&] { refiner.withdrawViews(); }));
  EXPECT_TRUE(ended_by([&] { refiner.groundMoved(); }));
  EXPECT_TRUE(ended_by([&] { refiner.forgetAerial(); }));
  EXPECT_FALSE(ended_by([] {}));
}

// Its author no longer tells that place from another.
TEST_F(Refiner, ACoarsePoseThatIsWithdrawnStartsNothing) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  refiner.withdrawCoarse();
  const auto out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kSearching);
  EXPECT_EQ(out.reason, "waiting for a coarse alignment or a manual guess");
}

TEST_F(Refiner, ALeapIsBelievedOnceAnotherCloudConfirmsIt) {
  refiner.setCoarse(scene.T_ground_map_mav_map);
  ASSERT_EQ(refiner.refine().status, RefineStatus::kConverged);
  // The ground map lies elsewhere, by what ICP reaches, and its robot says nothing of it.
  const Pose shift(Eigen::Translation3d(0.2, 0, 0));
  refiner.setGround(transformed(scene.ground, shift));
  const auto errorOf = [&](const Similarity& T) { return (T * centre - shift * (scene.truth * centre)).norm(); };
  RefineOutcome out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kSearching) << out.reason;
  EXPECT_NE(out.reason.find("confirms"), std::string::npos) << out.reason;
  EXPECT_NE(refiner.refine().status, RefineStatus::kConverged) << "the same clouds";
  EXPECT_LT((*refiner.refined() * centre - scene.truth * centre).norm(), 0.08) << "the old pose is kept meanwhile";
  refiner.addAerial(2, scene.aerial);
  out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(errorOf(*refiner.refined()), 0.08);
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
