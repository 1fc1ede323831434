// What counts for a place, how much at most, and when it is forgotten; how many measurements an overlap holds.
#include "evidence_sum.h"

#include <gtest/gtest.h>

#include <cmath>

#include "air_ground_common/geometry.h"
#include "comparison.h"

namespace heightmap_mcl {
namespace {

constexpr double kEnough = 10;
const RivalSettings kRival{0.4, 0.26};

air_ground_common::Pose at(double x, double yaw = 0) { return air_ground_common::yawPose(yaw, {x, 0, 0}); }

TEST(EvidenceSum, OneMapCountsForAtMostHalf) {
  EvidenceSum evidence(kEnough, kRival);
  evidence.placeAt(at(0), {0, 0});
  evidence.add(3, true, true);
  EXPECT_DOUBLE_EQ(evidence.sum(), 3);
  evidence.add(1000, true, true);
  EXPECT_DOUBLE_EQ(evidence.sum(), 8);
  for (int i = 0; i < 10; ++i) evidence.add(1000, true, true);
  EXPECT_DOUBLE_EQ(evidence.sum(), 2 * kEnough) << "no map is needed to outweigh more than that";
  evidence.add(-1000, true, true);
  EXPECT_DOUBLE_EQ(evidence.sum(), 1.5 * kEnough);
  for (int i = 0; i < 10; ++i) evidence.add(-1000, true, true);
  EXPECT_DOUBLE_EQ(evidence.sum(), 0) << "what spoke against it can be made up for at once";
  EXPECT_DOUBLE_EQ(evidence.guessSum(), 0);
}

TEST(EvidenceSum, WhatCannotTellPlacesApartCountsAgainstOnly) {
  EvidenceSum evidence(kEnough, kRival);
  evidence.placeAt(at(0), {0, 0});
  evidence.add(4, false, true);
  EXPECT_DOUBLE_EQ(evidence.sum(), 0);
  EXPECT_DOUBLE_EQ(evidence.guessSum(), 4);
  evidence.add(4, true, true);
  evidence.add(-1, false, false);
  EXPECT_DOUBLE_EQ(evidence.sum(), 3);
  EXPECT_DOUBLE_EQ(evidence.guessSum(), 7);
}

TEST(EvidenceSum, AnotherPlaceBeginsAnew) {
  EvidenceSum evidence(kEnough, kRival);
  const auto sumAfterMoveTo = [&](const air_ground_common::Pose& T, const Eigen::Vector2d& reference) {
    evidence.clear();
    evidence.placeAt(at(0), reference);
    evidence.add(5, true, true);
    evidence.placeAt(T, reference);
    EXPECT_TRUE(evidence.place()->isApprox(T, 0));
    return evidence.sum() + evidence.guessSum();
  };
  EXPECT_DOUBLE_EQ(sumAfterMoveTo(at(0.39), {0, 0}), 10);
  EXPECT_DOUBLE_EQ(sumAfterMoveTo(at(0.41), {0, 0}), 0);
  EXPECT_DOUBLE_EQ(sumAfterMoveTo(at(0, 0.25), {0, 0}), 10);
  EXPECT_DOUBLE_EQ(sumAfterMoveTo(at(0, -0.27), {0, 0}), 0);
  // A turn about the origin of mav_map carries what lies far from it away.
  EXPECT_DOUBLE_EQ(sumAfterMoveTo(at(0, 0.1), {3, 0}), 10);
  EXPECT_DOUBLE_EQ(sumAfterMoveTo(at(0, 0.1), {5, 0}), 0);
}

// A place that drifts is followed: each step is compared with the one before.
TEST(EvidenceSum, APlaceThatDriftsKeepsWhatItHas) {
  EvidenceSum evidence(kEnough, kRival);
  for (int i = 0; i < 6; ++i) {
    evidence.placeAt(at(0.3 * i), {0, 0});
    evidence.add(1, true, true);
  }
  EXPECT_DOUBLE_EQ(evidence.sum(), 6);
}

TEST(IndependentMeasurements, AreAsManyInCellsOfAnySize) {
  HeightMapLocalizerSettings settings;
  Agreement place;
  for (const double resolution : {0.01, 0.02, 0.05}) {
    settings.air_map.resolution = settings.ground_map.resolution = resolution;
    place.overlap = static_cast<int>(std::lround(8 / (resolution * resolution)));  // 8 m^2
    EXPECT_NEAR(independentMeasurements(place, settings), 50, 1e-9) << resolution;
  }
  place.overlap = 1;
  EXPECT_DOUBLE_EQ(independentMeasurements(place, settings), 1);
}

}  // namespace
}  // namespace heightmap_mcl
