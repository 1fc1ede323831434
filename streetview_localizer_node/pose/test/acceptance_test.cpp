#include "streetview_localizer/acceptance.h"

#include <gtest/gtest.h>

#include <functional>

#include "facade.h"

namespace streetview_localizer {
namespace {

using namespace simulation;

struct Count {
  int right = 0, wrong = 0, refused = 0;
  std::vector<std::string> reasons;
};

/// Poses judged over many scenes; wrong: accepted although more than 1 m or 3 degrees off.
Count judgeScenes(unsigned seed, int trials, const FacadeSettings& settings,
                  const std::function<void(Scene&, PosePrior&, Random&)>& change = {}) {
  Random random(seed);
  Count count;
  for (int trial = 0; trial < trials; ++trial) {
    Scene s = facadeScene(random, settings);
    PosePrior prior;
    if (change) change(s, prior, random);
    const PoseResult r = estimatePose(s.matches, s.camera, s.source, prior, {});
    const Acceptance a = judge(r, s.matches, s.camera, s.source, {}, {});
    EXPECT_FALSE(a.reason.empty());
    if (!a.accepted) {
      ++count.refused;
      count.reasons.push_back(a.reason);
      continue;
    }
    const bool right =
        positionError(r.T_world_camera, s.T_world_camera) < 1 &&
        air_ground_common::rotationAngle(r.T_world_camera.linear(), s.T_world_camera.linear()) < 3 * M_PI / 180;
    ++(right ? count.right : count.wrong);
  }
  return count;
}

TEST(Acceptance, TakesGoodPoses) {
  FacadeSettings settings;
  settings.relief = 0.2;
  const Count count = judgeScenes(1, 100, settings);
  EXPECT_GE(count.right, 97);
  EXPECT_EQ(count.wrong, 0);
}

// A plane has two poses. Small patches far away are the hard case: their perspective hardly tells the poses apart.
class Ambiguity : public testing::TestWithParam<std::tuple<double, double, double>> {};

TEST_P(Ambiguity, NeverTakesTheMirror) {
  const auto [span, relief, hidden] = GetParam();
  FacadeSettings settings;
  settings.span = span;
  settings.relief = relief;
  settings.hidden_relief = hidden;
  settings.distance = 14;
  settings.panorama_distance = 12;
  settings.outliers = 15;
  const Count count = judgeScenes(static_cast<unsigned>(100 * span + 10 * relief), 120, settings);
  EXPECT_EQ(count.wrong, 0);
  std::printf("span %.0f m, relief %.1f, unknown relief %.2f m: %d right, %d refused\n", span, relief, hidden,
              count.right, count.refused);
  if (span >= 12 && hidden == 0) {
    EXPECT_GE(count.right, 110);
  }
}
INSTANTIATE_TEST_SUITE_P(Sweep, Ambiguity,
                         testing::Combine(testing::Values(4.0, 8.0, 16.0), testing::Values(0.0, 0.3),
                                          testing::Values(0.0, 0.1)));

TEST(PlanarAmbiguity, GravityAndPredictionWidenTheMargin) {
  Random random(7);
  FacadeSettings settings;
  settings.span = 3;
  settings.max_side = 12;
  settings.distance = 14;
  settings.outliers = 10;
  int compared = 0;
  double alone = 0, predicted = 0, level = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const Scene s = facadeScene(random, settings);
    PosePrior prediction, gravity;
    prediction.T_world_camera = s.T_world_camera;
    prediction.T_world_camera->translation() += random.gaussVector(0.5);
    prediction.covariance.diagonal() << 0.25, 0.25, 0.25, 0.01, 0.01, 0.01;
    gravity.up_camera = s.T_world_camera.linear().transpose() * Eigen::Vector3d::UnitZ();
    PoseSettings pose;
    pose.find_competitor = false;
    const PoseResult a = estimatePose(s.matches, s.camera, s.source, {}, pose);
    const PoseResult b = estimatePose(s.matches, s.camera, s.source, prediction, pose);
    const PoseResult c = estimatePose(s.matches, s.camera, s.source, gravity, pose);
    ASSERT_TRUE(a.success && b.success && c.success);
    if (!a.alternative || !b.alternative || !c.alternative) continue;
    ++compared;
    alone += a.alternative_margin;
    predicted += b.alternative_margin;
    level += c.alternative_margin;
  }
  ASSERT_GT(compared, 10);
  EXPECT_GT(predicted / compared, alone / compared + 5);
  EXPECT_GT(level / compared, alone / compared + 1);
}

TEST(Acceptance, WrongPredictionDoesNotMakeAWrongPose) {
  FacadeSettings settings;
  settings.relief = 0.2;
  const Count count = judgeScenes(8, 60, settings, [](Scene& s, PosePrior& prior, Random&) {
    prior.T_world_camera = s.T_world_camera;
    prior.T_world_camera->translation() += Eigen::Vector3d(40, -30, 5);
    prior.covariance.diagonal() << 1, 1, 1, 0.01, 0.01, 0.01;
  });
  EXPECT_EQ(count.wrong, 0);
  EXPECT_GE(count.right, 57);
}

TEST(Acceptance, RefusesWhenTheNextWindowFitsNearlyAsWell) {
  FacadeSettings settings;
  settings.inliers = 30;
  settings.shifted = 28;
  settings.outliers = 40;
  const Count count = judgeScenes(20, 80, settings);
  EXPECT_EQ(count.wrong, 0);
  EXPECT_LE(count.right, 8);
  int named = 0;
  for (const std::string& reason : count.reasons) named += reason.find("another place") != std::string::npos;
  EXPECT_GE(named, 40);
}

TEST(Acceptance, AFewMatchesWithTheNextWindowDoNoHarm) {
  FacadeSettings settings;
  settings.inliers = 60;
  settings.shifted = 10;
  settings.outliers = 20;
  const Count count = judgeScenes(21, 60, settings);
  EXPECT_EQ(count.wrong, 0);
  EXPECT_GE(count.right, 55);
}

TEST(Acceptance, RefusesTheNextWindowAlone) {
  // The right matches are missing: what agrees is a small part of the matches.
  FacadeSettings settings;
  settings.inliers = 0;
  settings.shifted = 20;
  settings.outliers = 120;
  const Count count = judgeScenes(22, 60, settings);
  EXPECT_EQ(count.wrong, 0);
}

TEST(Acceptance, RefusesMirroredImagesAndRandomMatches) {
  const Count mirrored = judgeScenes(30, 40, {}, [](Scene& s, PosePrior&, Random&) {
    for (auto& c : s.matches) c.pixel.x() = s.camera.width - 1 - c.pixel.x();
  });
  EXPECT_EQ(mirrored.refused, 40);
  const Count random_matches = judgeScenes(31, 60, {}, [](Scene& s, PosePrior&, Random& random) {
    for (auto& c : s.matches) c.pixel = {random.uniform(0, 640), random.uniform(0, 480)};
  });
  EXPECT_EQ(random_matches.refused, 60);
}

TEST(Acceptance, RefusesFarFromThePanorama) {
  Random random(40);
  FacadeSettings settings;
  settings.relief = 0.2;
  const Scene s = facadeScene(random, settings);
  PointSource far = s.source;
  far.position += s.T_world_facade.linear() * Eigen::Vector3d(22, 0, 0);
  const PoseResult r = estimatePose(s.matches, s.camera, far, {}, {});
  ASSERT_TRUE(r.success);
  const Acceptance a = judge(r, s.matches, s.camera, far, {}, {});
  EXPECT_FALSE(a.accepted);
  EXPECT_NE(a.reason.find("from the panorama, at most 15.0"), std::string::npos) << a.reason;
  AcceptanceSettings wide;
  wide.max_range = 60;
  EXPECT_TRUE(judge(r, s.matches, s.camera, far, {}, wide).accepted);
}

TEST(Acceptance, RepeatedMatchesOfOnePlaceCountOnce) {
  Random random(41);
  FacadeSettings settings;
  settings.inliers = 9;
  settings.outliers = 0;
  Scene s = facadeScene(random, settings);
  const std::vector<Correspondence> once = s.matches;
  for (int i = 0; i < 10; ++i) s.matches.insert(s.matches.end(), once.begin(), once.end());
  const PoseResult r = estimatePose(s.matches, s.camera, s.source, {}, {});
  const PoseEvidence e = gatherEvidence(r, s.matches, s.camera, s.source, {});
  EXPECT_LE(e.inliers, 9);
  EXPECT_FALSE(judge(r, s.matches, s.camera, s.source, {}, {}).accepted);
}

TEST(Acceptance, FailedPoseKeepsItsReason) {
  const PoseResult r = estimatePose({}, camera(), {}, {}, {});
  const Acceptance a = judge(r, {}, camera(), {}, {}, {});
  EXPECT_FALSE(a.accepted);
  EXPECT_EQ(a.reason, r.reason);
  AcceptanceSettings bad;
  bad.min_inliers = 0;
  EXPECT_THROW(judge(r, {}, camera(), {}, {}, bad), std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
