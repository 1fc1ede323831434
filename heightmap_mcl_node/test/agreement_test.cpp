// What agrees at a placement: the kernel against the plain reference, and that what one map lacks moves nothing.
#include <gtest/gtest.h>

#include "heightmap_mcl/global_search.h"
#include "random_maps.h"

using namespace heightmap_mcl;
using namespace heightmap_mcl::random_maps;

class AgreementMatchesReference : public ::testing::TestWithParam<Cells> {};

TEST_P(AgreementMatchesReference, AtRandomPoses) {
  const MapPair maps(GetParam());
  const auto cells = aerialCells(maps.air, kReference, GetParam().edge);
  const DirectCost direct(maps.ground);
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> x(-1.5, 3.6), y(2, 5.3), yaw(-4, 4), offset(-0.3, 0.3);
  CostSettings settings{0.3};
  settings.cutoff = 0.2;
  int finite = 0;
  for (int i = 0; i < 300; ++i) {
    const PlanarPose pose{x(random), y(random), yaw(random)};
    const double d = offset(random);
    const Agreement fast = direct.agreement(cells, pose, d, settings);
    const Agreement slow = agreementReference(maps.air, maps.ground, kReference, pose, d, settings, GetParam().edge);
    // Single precision may put a cell whose centre lies on a border into the neighbour.
    EXPECT_NEAR(fast.overlap, slow.overlap, 4);
    if (std::isinf(slow.cost) || std::isinf(fast.cost)) continue;
    ++finite;
    EXPECT_NEAR(fast.cost, slow.cost, 2e-3 * slow.cost);
    EXPECT_NEAR(fast.score, slow.score, 2e-3 * slow.score);
    EXPECT_NEAR(fast.raised, slow.raised, 4);
    EXPECT_NEAR(fast.agreeing, slow.agreeing, 5e-3);
    EXPECT_NEAR(fast.offset, slow.offset, 2e-3);
    EXPECT_NEAR(fast.dz, slow.dz, 2e-3);
  }
  EXPECT_GT(finite, 60);
}
INSTANTIATE_TEST_SUITE_P(BoundsAndEdges, AgreementMatchesReference, ::testing::ValuesIn(kKindsOfCells));

TEST(Agreement, HandComputedValue) {
  HeightMap ground, air;
  for (HeightMap* map : {&ground, &air}) {
    map->resolution = 1;
    map->origin_x = map->origin_y = 0;
    map->width = 6;
    map->height = 1;
    map->floor = 2;
    map->cap = 5;
  }
  // Above the floor: bare in both; 0.05 apart; a box that only the ground robot saw; a hole; a box in both, 0.03 apart.
  ground.heights = {2, 2, 2, 2.5, 2, 2.4f};
  air.heights = {2, 2, 2.05f, 2, kHole, 2.43f};
  air.floor = 2;
  CostSettings settings{0.5};
  settings.cutoff = 0.1;
  const auto a = agreementReference(air, ground, {0, 0}, {0, 0, 0}, 0.01, settings);
  EXPECT_EQ(a.overlap, 5);
  EXPECT_NEAR(a.cost, (2 * 1e-4 + 0.04 * 0.04 + 0.1 * 0.1 + 0.02 * 0.02) / 5, 1e-8);
  EXPECT_NEAR(a.score, a.cost, 1e-12);  // all cells of the smaller map have a partner
  EXPECT_EQ(a.raised, 2);
  EXPECT_NEAR(a.agreeing, 0.5, 1e-12);
  EXPECT_NEAR(a.offset, 0.08 / 4, 1e-7);
  EXPECT_NEAR(a.dz, -0.02, 1e-7);
  // Shifted by a cell to the right the last one lies outside: a fifth is charged half of the most.
  const auto shifted = agreementReference(air, ground, {0, 0}, {1, 0, 0}, 0, settings);
  EXPECT_EQ(shifted.overlap, 4);
  EXPECT_NEAR(shifted.score, 0.8 * shifted.cost + 0.2 * 0.5 * 0.01, 1e-12);
}

/// What one map lacks moves the minimum of eq. 2, but not that of the agreement.
TEST(Agreement, WhatOneMapLacksMovesNothing) {
  HeightMap ground = randomMap(120, 110, 9, 0);
  for (float& h : ground.heights) h = 5;
  const auto box = [](HeightMap& map, int c0, int r0, int c1, int r1, float h) {
    for (int r = r0; r < r1; ++r) {
      for (int c = c0; c < c1; ++c) map.at(r, c) = h;
    }
  };
  box(ground, 40, 40, 50, 52, 5.3f);
  box(ground, 66, 62, 74, 70, 5.25f);
  const PlanarPose truth{0.31, 0.42, 0.2};
  HeightMap air = cutOut(ground, truth, 0.7, 100, 90);
  // A cupboard at the rim of what the MAV saw, of which it saw nothing.
  box(ground, 106, 40, 109, 60, 6.f);
  const AerialCells cells = aerialCells(air, {0, 0});
  const DirectCost direct(ground);
  CostSettings settings{0.5};
  const PlanarPose start{truth.x + 0.04, truth.y - 0.05, truth.yaw + 0.05};
  const Placement found = descend(direct, cells, start, 0.08, 0.05, settings);
  EXPECT_NEAR(found.pose.x, truth.x, 0.03);
  EXPECT_NEAR(found.pose.y, truth.y, 0.03);
  EXPECT_NEAR(found.pose.yaw, truth.yaw, 0.015);
  EXPECT_NEAR(found.agreement.dz, 0.7, 0.005);
  double lowest = kInfinity;
  PlanarPose by_squares;
  for (int i = 0; i < 31 * 31; ++i) {
    const PlanarPose p{truth.x + 0.02 * (i % 31 - 15), truth.y + 0.02 * (i / 31 - 15), truth.yaw};
    const double cost = direct(cells, p, settings).cost;
    if (cost >= lowest) continue;
    lowest = cost;
    by_squares = p;
  }
  EXPECT_GT(std::hypot(by_squares.x - truth.x, by_squares.y - truth.y), 0.05);
}
