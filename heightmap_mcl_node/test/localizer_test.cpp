// Estimate and verdict on worlds with exact truth.
#include "heightmap_mcl/localizer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "air_ground_common/linear_algebra.h"
#include "synthetic_world.h"

using namespace heightmap_mcl;
using air_ground_common::Pose;
using air_ground_common::yawOf;

namespace {

struct Outcome {
  CoarseEstimate last;
  synthetic::Error error;
  int converged = 0, wrong = 0, first_converged = -1, guesses = 0;
  std::vector<Status> statuses;
};

Outcome play(const synthetic::Run& run, HeightMapLocalizer& localizer) {
  Outcome outcome;
  localizer.setGround(run.ground);
  for (std::size_t k = 0; k < run.aerial.size(); ++k) {
    EXPECT_TRUE(localizer.addAerial(run.aerial[k]));
    const auto& e = localizer.estimate();
    outcome.last = e;
    outcome.error = synthetic::errorOf(e.T_ground_mav, run.T_ground_mav[k], run.aerial[k].reference);
    outcome.statuses.push_back(e.status);
    EXPECT_FALSE(e.reason.empty());
    if (e.status == Status::kSearching) {
      EXPECT_GE(e.covariance.diagonal().minCoeff(), 1e6);
    }
    if (e.has_pose) {
      EXPECT_GT(air_ground_common::symmetricEigen(e.covariance).values[0], 0);
      EXPECT_TRUE(e.covariance.allFinite());
      EXPECT_TRUE(e.reference_point.allFinite());
    }
    outcome.guesses += e.guess;
    if (e.status != Status::kConverged) continue;
    if (outcome.converged++ == 0) outcome.first_converged = static_cast<int>(k);
    outcome.wrong += outcome.error.position > 0.25 || outcome.error.yaw > 5 * M_PI / 180;
  }
  return outcome;
}

Outcome play(const synthetic::Options& options, const HeightMapLocalizerSettings& settings = {}) {
  HeightMapLocalizer localizer(settings);
  return play(synthetic::makeRun(options), localizer);
}

}  // namespace

class Boxes : public ::testing::TestWithParam<int> {};

TEST_P(Boxes, ConvergesWithoutAGuessAndIsNeverWronglySure) {
  synthetic::Options options;
  options.seed = GetParam();
  options.aerial_clouds = 8;
  const auto run = synthetic::makeRun(options);
  HeightMapLocalizer localizer({});
  const auto outcome = play(run, localizer);
  EXPECT_EQ(outcome.wrong, 0);
  EXPECT_EQ(outcome.last.status, Status::kConverged) << outcome.last.reason;
  EXPECT_LT(outcome.error.position, 0.15);
  EXPECT_LT(outcome.error.yaw, 0.05);
  EXPECT_LT(outcome.error.z, 0.15);
}
INSTANTIATE_TEST_SUITE_P(Seeds, Boxes, ::testing::Values(501, 502, 503));

/// Height that a twentieth of the points are below.
double floorOf(const AerialCloud& cloud) {
  std::vector<float> z;
  for (const auto& p : cloud.points) z.push_back(p.z());
  const auto rank = z.begin() + static_cast<long>(z.size() / 20);
  std::nth_element(z.begin(), rank, z.end());
  return *rank;
}

/// A flight from elsewhere and back: three clouds of other ground, those of the run, four of other ground.
TEST(HeightMapLocalizer, WhatTheMavSeesElsewhereDoesNotHideWhereItIs) {
  synthetic::Options options;
  options.seed = 21;
  options.aerial_clouds = 4;
  const synthetic::Run run = synthetic::makeRun(options);
  options.seed = 22;
  options.aerial_clouds = 1;
  const AerialCloud elsewhere = synthetic::makeRun(options).aerial[0];

  HeightMapLocalizerSettings settings;
  settings.air_map.resolution = settings.ground_map.resolution = 0.05;
  settings.coarse_factor = 2;
  HeightMapLocalizer localizer(settings);
  ASSERT_TRUE(localizer.setGround(run.ground));
  const auto addElsewhere = [&](int k) {
    Eigen::Vector3d shift = run.aerial[0].reference - elsewhere.reference +
                            9.0 * Eigen::Vector3d(std::cos(k * M_PI / 2), std::sin(k * M_PI / 2), 0);
    shift.z() = floorOf(run.aerial[0]) - floorOf(elsewhere);
    AerialCloud cloud;
    cloud.reference = elsewhere.reference + shift;
    for (const auto& p : elsewhere.points) cloud.points.push_back(p + shift.cast<float>());
    ASSERT_TRUE(localizer.addAerial(cloud));
  };
  for (int k = 3; k > 0; --k) {
    addElsewhere(k);
    EXPECT_NE(localizer.estimate().status, Status::kConverged) << k;
  }
  for (std::size_t k = 0; k < run.aerial.size(); ++k) {
    ASSERT_TRUE(localizer.addAerial(run.aerial[k]));
    const CoarseEstimate& e = localizer.estimate();
    const auto error = synthetic::errorOf(e.T_ground_mav, run.T_ground_mav[k], run.aerial[k].reference);
    std::printf("cloud %zu: %s, %.3f m, overlap %.2f; %s\n", k, toString(e.status), error.position, e.overlap,
                e.reason.c_str());
    if (k < 2) continue;
    EXPECT_LT(error.position, 0.25) << k;
    EXPECT_LT(e.overlap, 0.5) << "the merged map lies elsewhere for the most part";
  }
  EXPECT_EQ(localizer.estimate().status, Status::kConverged) << localizer.estimate().reason;
  for (int k = 1; k <= settings.accumulate; ++k) {
    addElsewhere(k);
    EXPECT_EQ(localizer.estimate().status, Status::kConverged) << k << ": " << localizer.estimate().reason;
  }
}

// The odometry closes a loop: later clouds lie elsewhere in mav_map than where those at hand were.
TEST(HeightMapLocalizer, CloudsAtHandFollowCorrectionsOfTheirMap) {
  synthetic::Options options;
  options.seed = 501;
  options.aerial_clouds = 12;
  const synthetic::Run run = synthetic::makeRun(options);
  const air_ground_common::Similarity S{1, Eigen::Matrix3d::Identity(), {0.3, 0, 0}};
  constexpr std::int64_t kBefore = 8;
  air_ground_common::CloudCorrections corrections;
  for (std::int64_t stamp = 1; stamp <= kBefore; ++stamp) corrections[stamp] = S;
  HeightMapLocalizer localizer({});
  ASSERT_TRUE(localizer.setGround(run.ground));
  for (std::size_t k = 0; k < run.aerial.size(); ++k) {
    AerialCloud cloud = run.aerial[k];
    cloud.stamp = static_cast<std::int64_t>(k) + 1;
    Pose T_ground_mav = run.T_ground_mav[k];
    if (cloud.stamp == kBefore + 1) {
      localizer.correct(corrections);
      localizer.correct(corrections);  // said again, it has happened once
    }
    if (cloud.stamp > kBefore) {
      moveBy(S, &cloud);
      T_ground_mav = T_ground_mav * Eigen::Translation3d(-S.t);
    }
    ASSERT_TRUE(localizer.addAerial(cloud));
    if (k < 4) continue;
    const CoarseEstimate& e = localizer.estimate();
    const auto error = synthetic::errorOf(e.T_ground_mav, T_ground_mav, cloud.reference);
    std::printf("cloud %zu: %s, %.3f m\n", k, toString(e.status), error.position);
    EXPECT_EQ(e.status, Status::kConverged) << k << ": " << e.reason;
    EXPECT_LT(error.position, 0.08) << k << ": 0.27 to 0.1 m where those of before stay";
  }
}

TEST(HeightMapLocalizer, KnownHeadingIsUsed) {
  synthetic::Options options;
  options.seed = 504;
  options.aerial_clouds = 5;
  const auto run = synthetic::makeRun(options);
  HeightMapLocalizer localizer({});
  Prior prior;
  prior.yaw = yawOf(run.T_ground_mav[0].rotation()) + 0.05;
  prior.yaw_sigma = 0.1;
  localizer.setPrior(prior);
  const auto outcome = play(run, localizer);
  EXPECT_EQ(outcome.wrong, 0);
  EXPECT_LT(outcome.error.position, 0.2);
  // A wrong heading that excludes the truth must not be sold as a solution.
  prior.yaw = *prior.yaw + M_PI;
  HeightMapLocalizer misled({});
  misled.setPrior(prior);
  EXPECT_EQ(play(run, misled).converged, 0);
}

TEST(HeightMapLocalizer, RoomWithWallsIsAligned) {
  // Walls of 2.5 m that each view cuts elsewhere, tables seen from below, a ceiling: the paper's highest points fail.
  synthetic::Options options;
  options.world = synthetic::World::kRoom;
  options.aerial_clouds = 6;
  int right = 0;
  for (int seed : {201, 202, 203}) {
    options.seed = seed;
    const auto outcome = play(options);
    EXPECT_EQ(outcome.wrong, 0) << "seed " << seed;
    right += outcome.error.position < 0.25 && outcome.error.yaw < 5 * M_PI / 180;
  }
  EXPECT_GE(right, 2);
}

TEST(HeightMapLocalizer, APlaceWithoutRivalIsAGuessWhereADirectionIsFixedLoosely) {
  synthetic::Options options;
  options.world = synthetic::World::kRoom;
  for (const auto& [seed, clouds] : {std::pair{720120, 3}, std::pair{720120, 4}, std::pair{720142, 4}}) {
    options.seed = seed;
    options.aerial_clouds = clouds;
    HeightMapLocalizerSettings settings;
    settings.seed = seed;
    const auto outcome = play(options, settings);
    EXPECT_TRUE(outcome.last.guess) << outcome.last.reason;
    EXPECT_EQ(outcome.last.status, Status::kDegenerate);
    EXPECT_NE(outcome.last.reason.find("guess"), std::string::npos) << outcome.last.reason;
    EXPECT_LT(outcome.error.position, 0.3);
    EXPECT_LT(outcome.error.yaw, 0.2);
    settings.verdict.guess_ratio = settings.verdict.probe_ratio;
    EXPECT_FALSE(play(options, settings).last.guess);
  }
}

TEST(HeightMapLocalizer, ThePapersFilterGathersAtTheTruth) {
  synthetic::Options options;
  options.seed = 503;
  options.aerial_clouds = 8;
  const auto run = synthetic::makeRun(options);
  HeightMapLocalizerSettings settings = paperSettings({});
  EXPECT_EQ(settings.filter.sampling_sigma, 0.08);
  settings.filter.sampling_sigma = settings.filter.weight_sigma = 0.004;  // the paper's is too wide without the heading
  HeightMapLocalizer localizer(settings);
  Prior prior;
  prior.yaw = yawOf(run.T_ground_mav[0].rotation());
  prior.yaw_sigma = 0.05;
  prior.position = run.T_ground_robot.translation().head<2>();
  prior.position_radius = 6;
  prior.position_reference = run.aerial[0].reference.head<2>();
  localizer.setPrior(prior);
  const auto outcome = play(run, localizer);
  EXPECT_LT(outcome.error.position, 0.3);
  EXPECT_EQ(outcome.last.restarts, 0);
  // The estimate is the particles' mean.
  const Eigen::Vector3d mav = outcome.last.T_ground_mav * run.aerial.back().reference;
  EXPECT_NEAR(mav.x(), outcome.last.particle_mean.x, 1e-6);
  EXPECT_NEAR(mav.y(), outcome.last.particle_mean.y, 1e-6);
}

TEST(HeightMapLocalizer, FlatFloorIsDegenerate) {
  synthetic::Options options;
  options.world = synthetic::World::kFlatFloor;
  options.aerial_clouds = 5;
  for (int seed : {1, 2}) {
    options.seed = seed;
    const auto outcome = play(options);
    EXPECT_EQ(outcome.converged, 0);
    EXPECT_EQ(outcome.last.status, Status::kDegenerate) << outcome.last.reason;
    // Nothing but the height is known.
    const auto sigma = outcome.last.covariance.diagonal().cwiseSqrt();
    EXPECT_GT(sigma[0], 2);
    EXPECT_GT(sigma[1], 2);
    EXPECT_LT(sigma[2], 0.3);
    EXPECT_GT(sigma[5], 3);
  }
}

TEST(HeightMapLocalizer, EndlessRidgeIsNeverConverged) {
  synthetic::Options options;
  options.world = synthetic::World::kRidge;
  options.aerial_clouds = 5;
  // Seed 37: the aerial maps end where the ground map does, and only the charge for unknown cells tells one place from
  // another.
  for (int seed : {3, 37}) {
    options.seed = seed;
    HeightMapLocalizerSettings settings;
    settings.seed = options.seed;
    const auto outcome = play(options, settings);
    EXPECT_EQ(outcome.converged + outcome.guesses, 0) << "seed " << seed;
  }
}

TEST(HeightMapLocalizer, BareFloorIsNoRivalOfStructure) {
  // A ground robot that has seen little: the front faces of some boxes and the floor before them. Anywhere on the wide
  // bare floor about the boxes eq. 2 is low, since most of what the ground map shows is floor.
  struct Box {
    double x, y, width, depth, height;
    bool holds(double px, double py) const { return px >= x && px <= x + width && py >= y && py <= y + depth; }
  };
  const std::vector<Box> boxes{{-1.1, -0.4, 0.5, 0.4, 1.0},
                               {0.1, -0.7, 0.6, 0.35, 0.6},
                               {0.9, -0.2, 0.3, 0.6, 1.8},
                               {-0.4, 0.2, 0.4, 0.5, 1.4},
                               {-1.4, 0.5, 0.6, 0.4, 0.8}};
  AerialCloud air;
  std::vector<Eigen::Vector3f> ground;
  for (double x = -3; x < 3; x += 0.01) {
    for (double y = -3; y < 3; y += 0.01) {
      const auto box = std::find_if(boxes.begin(), boxes.end(), [&](const Box& b) { return b.holds(x, y); });
      const double height = box == boxes.end() ? 0 : box->height;
      air.points.push_back(Eigen::Vector3d(x, y, height).cast<float>());
      // Of a box the front face, and not up to its edge; nothing behind it.
      const bool seen = x > -1.5 && x < 1.5 && y > -1 && y < 0.9 && (box == boxes.end() || y < box->y + 0.1);
      if (seen) ground.push_back(Eigen::Vector3d(x, y, 0.95 * height).cast<float>());
    }
  }
  // By the heights of fronts alone: as bounds, they leave this little map DEGENERATE.
  HeightMapLocalizerSettings settings;
  settings.air_map.tops = settings.ground_map.tops = Tops::kHighest;
  HeightMapLocalizer localizer(settings);
  localizer.setGround(ground);
  for (int k = 0; k < 6; ++k) {
    air.reference = {0.3 * k, 0.1 * k, 2};
    ASSERT_TRUE(localizer.addAerial(air));
  }
  const auto& e = localizer.estimate();
  EXPECT_EQ(e.status, Status::kConverged) << e.reason;
  EXPECT_LT(e.T_ground_mav.translation().head<2>().norm(), 0.1);
  EXPECT_GT(e.rival_ratio, 1.5);
}

TEST(HeightMapLocalizer, IdenticalBoxesAreAmbiguous) {
  synthetic::Options options;
  options.world = synthetic::World::kIdenticalBoxes;
  options.aerial_clouds = 6;
  for (int seed : {1, 2}) {
    options.seed = seed;
    const auto outcome = play(options);
    EXPECT_EQ(outcome.converged, 0);
    EXPECT_EQ(outcome.last.status, Status::kAmbiguous) << outcome.last.reason;
    EXPECT_LT(outcome.last.rival_ratio, 1.3);
    // The rival lies within the covariance.
    const auto sigma = outcome.last.covariance.diagonal().cwiseSqrt();
    EXPECT_GT(std::hypot(std::hypot(sigma[0], sigma[1]), sigma[5]), 0.25);
    if (outcome.last.rival_distance > 1) {
      EXPECT_GT(std::hypot(sigma[0], sigma[1]), 0.5);
    }
  }
}

// Symmetric rows, of which the ground robot saw one end better: what falls into holes at the other end made the right
// end as good as certain, or the wrong one.
TEST(HeightMapLocalizer, WhatWasSeenOfEqualBoxesDoesNotTellThemApart) {
  synthetic::Options options;
  options.world = synthetic::World::kIdenticalBoxes;
  options.aerial_clouds = 8;
  for (int seed : {834027, 832137}) {
    options.seed = seed;
    EXPECT_EQ(play(options).converged, 0) << seed;
  }
}

// Most cells are bare floor: costs differ by little, and heights vary by little.
TEST(HeightMapLocalizer, AFewBoxesOnABareFloorAreEnough) {
  synthetic::Options options;
  options.world = synthetic::World::kFewBoxes;
  options.aerial_clouds = 6;
  options.cloud_noise = options.smooth_noise = 0.01;
  int converged = 0;
  for (int seed : {1, 2, 3}) {
    options.seed = seed;
    options.other_world = false;
    const auto outcome = play(options);
    EXPECT_EQ(outcome.wrong, 0) << seed;
    converged += outcome.last.status == Status::kConverged;
    options.other_world = true;
    EXPECT_EQ(play(options).converged, 0) << seed;
  }
  EXPECT_GE(converged, 2);
}

TEST(HeightMapLocalizer, ASingleBoxIsNot) {
  HeightMapLocalizer localizer({});
  std::vector<Eigen::Vector3f> floor;
  for (int i = 0; i < 200; ++i)
    for (int j = 0; j < 200; ++j)
      floor.emplace_back(0.02f * i, 0.02f * j, i > 90 && i < 120 && j > 90 && j < 120 ? 0.4f : 0.f);
  localizer.setGround(floor);
  for (int k = 0; k < 6; ++k) {
    ASSERT_TRUE(localizer.addAerial({floor, {0.1 * k, 0, 2}}));
    EXPECT_NE(localizer.estimate().status, Status::kConverged);
  }
}

TEST(HeightMapLocalizer, CloudsThatWaitedAreSearchedTogether) {
  synthetic::Options options;
  options.seed = 505;
  options.aerial_clouds = 10;
  const auto run = synthetic::makeRun(options);
  HeightMapLocalizer each({}), together({});
  each.setGround(run.ground);
  together.setGround(run.ground);
  std::size_t k = 0;
  for (; k < run.aerial.size() && together.estimate().status != Status::kConverged; ++k) {
    each.addAerial(run.aerial[k]);
    together.addAerial(run.aerial[k]);
  }
  ASSERT_LT(k + 2, run.aerial.size());
  EXPECT_TRUE(together.keepGround(run.ground));
  for (; k < run.aerial.size(); ++k) {
    each.addAerial(run.aerial[k]);
    k + 1 < run.aerial.size() ? together.keepAerial(run.aerial[k]) : together.addAerial(run.aerial[k]);
  }
  const auto &a = each.estimate(), &b = together.estimate();
  EXPECT_EQ(b.status, Status::kConverged) << b.reason;
  EXPECT_EQ(b.maps, a.maps);
  const auto error = synthetic::errorOf(b.T_ground_mav, run.T_ground_mav.back(), run.aerial.back().reference);
  EXPECT_LT(error.position, 0.15);
  EXPECT_LT(error.yaw, 0.05);
  EXPECT_LT((b.T_ground_mav.translation() - a.T_ground_mav.translation()).norm(), 0.05);
}

TEST(HeightMapLocalizer, BadCloudsChangeNothing) {
  HeightMapLocalizer localizer({});
  const float nan = std::nanf("");
  EXPECT_FALSE(localizer.addAerial({}));
  EXPECT_FALSE(localizer.addAerial({{{nan, nan, nan}}, Eigen::Vector3d::Zero()}));
  EXPECT_FALSE(localizer.addAerial({{{0, 0, 0}}, Eigen::Vector3d(std::nan(""), 0, 0)}));
  EXPECT_FALSE(localizer.hasAerial());
}

TEST(HeightMapLocalizer, AerialCloudsFarApartAreNotMerged) {
  HeightMapLocalizer localizer({});
  AerialCloud cloud;
  for (int i = 0; i < 100; ++i) cloud.points.emplace_back(0.02f * i, 0.01f * i, 0.f);
  ASSERT_TRUE(localizer.addAerial(cloud));
  EXPECT_EQ(localizer.farMapsDropped(), 0u);
  for (auto& p : cloud.points) p.x() += 1000;  // the odometry has jumped
  cloud.reference.x() += 1000;
  ASSERT_TRUE(localizer.addAerial(cloud));
  EXPECT_EQ(localizer.farMapsDropped(), 1u);
  EXPECT_LT(localizer.aerialMap().width, 200);
}

TEST(HeightMapLocalizer, SameSeedSameResult) {
  synthetic::Options options;
  options.seed = 506;
  options.aerial_clouds = 3;
  const auto run = synthetic::makeRun(options);
  HeightMapLocalizer a({}), b({});
  const auto first = play(run, a), second = play(run, b);
  EXPECT_EQ(first.last.T_ground_mav.matrix(), second.last.T_ground_mav.matrix());
  EXPECT_EQ(first.last.covariance, second.last.covariance);
  ASSERT_EQ(a.filter().particles().size(), b.filter().particles().size());
  EXPECT_EQ(a.filter().particles()[7].pose.x, b.filter().particles()[7].pose.x);
}

TEST(HeightMapLocalizer, BadSettingsAreNamed) {
  HeightMapLocalizerSettings settings;
  settings.verdict.ambiguity_ratio = 0.9;
  try {
    HeightMapLocalizer localizer(settings);
    FAIL();
  } catch (const std::invalid_argument& e) {
    EXPECT_NE(std::string(e.what()).find("ambiguity_ratio"), std::string::npos);
  }
}
