// Equation 2: the fast kernels against the plain reference, and the signs of offset, heading and dz.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "heightmap_mcl/fft_cost.h"
#include "heightmap_mcl/global_search.h"
#include "random_maps.h"

using namespace heightmap_mcl;
using namespace heightmap_mcl::random_maps;

TEST(Zmssd, HandComputedValue) {
  HeightMap ground, air;
  ground.resolution = air.resolution = 1;
  ground.width = air.width = 3;
  ground.height = air.height = 1;
  ground.heights = {1, 2, kHole};
  air.heights = {4, 7, 9};
  // d = (3, 5), mean 4, sum of squares about it 2, eta = 1/4.
  const CostSettings settings{0.5, 0.3};
  const auto value = zmssdReference(air, ground, Eigen::Vector2d::Zero(), {0, 0, 0}, settings);
  EXPECT_EQ(value.overlap, 2);
  EXPECT_NEAR(value.cost, 0.5, 1e-12);
  EXPECT_NEAR(value.score, 0.5, 1e-12);  // all of the ground map's two cells, the fewer ones, have a partner
  EXPECT_NEAR(value.dz, -4, 1e-12);
  // One of two cells is half of them: enough for a threshold of one half, at a charge, and not for more.
  const auto half = zmssdReference(air, ground, Eigen::Vector2d::Zero(), {1, 0, 0}, settings);
  EXPECT_NEAR(half.cost, 0, 1e-12);
  EXPECT_NEAR(half.score, 0.3 / 2, 1e-12);
  EXPECT_TRUE(std::isinf(zmssdReference(air, ground, Eigen::Vector2d::Zero(), {1, 0, 0}, {0.6, 0.3}).cost));
}

TEST(Zmssd, BoundsByHand) {
  HeightMap ground, air;
  ground.resolution = air.resolution = 1;
  ground.width = air.width = 6;
  ground.height = air.height = 1;
  ground.cap = air.cap = 1;
  ground.floor = 10;
  air.floor = -2;
  // Levels at 0.25, 0.5, 0.75 and 1 m above the floor.
  ground.heights = {10, 10.4f, 11, 10.6f, 10.9f, 10.1f};
  ground.bounds = {0, 0, 1, 1, 1, 0};
  air.heights = {-2, -1.5f, -1.8f, -1.2f, -1, -1};
  air.bounds = {0, 0, 0, 0, 1, 1};
  // Heights in both: d = 0, 0.1. The ground's bound of 1 against 0.2: 0.8 lacking; its bound of 0.6, at 0.5, against
  // 0.8: nothing. Two bounds: nothing. The aerial bound of 1 against 0.1: 0.9.
  const auto value = zmssdReference(air, ground, Eigen::Vector2d::Zero(), {0, 0, 0}, {0.5, 0});
  EXPECT_EQ(value.overlap, 6);
  EXPECT_NEAR(value.cost, (2 * 0.05 * 0.05 + 0.8 * 0.8 + 0.9 * 0.9) / 12, 1e-6);
  EXPECT_NEAR(value.dz, 12 - 0.05, 1e-6);
  // A wall that one robot saw up to 0.6 m and the other up to 1 m is the same wall; as heights, they differ.
  ground.heights = {10, 10, 10, 10.6f, 10.6f, 10.6f};
  air.heights = {-2, -2, -2, -1, -1, -1};
  ground.bounds = air.bounds = {0, 0, 0, 1, 1, 1};
  EXPECT_NEAR(zmssdReference(air, ground, Eigen::Vector2d::Zero(), {0, 0, 0}, {0.5, 0}).cost, 0, 1e-9);
  ground.bounds.clear();
  air.bounds.clear();
  EXPECT_GT(zmssdReference(air, ground, Eigen::Vector2d::Zero(), {0, 0, 0}, {0.5, 0}).cost, 0.01);
}

TEST(Zmssd, WhatExplainsNothingHasNoPartners) {
  // A step of 2 m in the ground map; one cell in four steps out of line in the aerial maps.
  HeightMap ground;
  ground.resolution = 1;
  ground.width = 4;
  ground.height = 1;
  ground.heights = {0, 0, 2, 2};
  const auto with = [&](std::vector<float> heights) {
    HeightMap air = ground;
    air.heights = std::move(heights);
    return zmssdReference(air, ground, Eigen::Vector2d::Zero(), {0, 0, 0}, {0.5, 0.8, 0.25, 0.1});
  };
  // The same, 5 m higher.
  const auto same = with({5, 5, 7, 7});
  EXPECT_NEAR(same.relief_air, 1, 1e-9);
  EXPECT_NEAR(same.relief_ground, 1, 1e-9);
  EXPECT_NEAR(same.explained, 1, 1e-9);
  EXPECT_NEAR(same.score, 0, 1e-9);
  // Bare floor costs half the step's variance and explains none of it: charged for all cells.
  const auto bare = with({5, 5, 5, 5});
  EXPECT_NEAR(bare.relief_air, 0, 1e-9);
  EXPECT_NEAR(bare.cost, 0.5, 1e-9);
  EXPECT_NEAR(bare.explained, 0, 1e-9);
  EXPECT_NEAR(bare.score, 0.5 + 0.8, 1e-9);
  // d = (0, 0, 0, -1.8): cost 0.30375; V = 1, explained 0.3925, above 0.25.
  const auto most = with({0, 0, 2, 0.2f});
  EXPECT_NEAR(most.explained, 1 - 2 * 0.30375, 1e-6);
  EXPECT_NEAR(most.score, most.cost, 1e-6);
  // d = (0, 0, 0, -2.2): cost 0.45375, explained 0.0925: 0.37 of its partners are believed.
  const auto little = with({0, 0, 2, -0.2f});
  EXPECT_NEAR(little.explained, 1 - 2 * 0.45375, 1e-5);
  EXPECT_NEAR(little.score, little.cost + 0.8 * (1 - little.explained / 0.25), 1e-6);
  // Opposite structure explains less than nothing.
  EXPECT_NEAR(with({2, 2, 0, 0}).explained, -3, 1e-9);
  // Both flat within min_relief: nothing to explain, nothing charged.
  ground.heights = {0, 0.01f, 0, 0.01f};
  const auto flat = with({0.01f, 0, 0.01f, 0});
  EXPECT_GT(flat.explained, 0.95);
  EXPECT_NEAR(flat.score, flat.cost, 1e-9);
}

TEST(Zmssd, ACellByAnEdgeIsAsHighAsAnythingThere) {
  // A box of 1 m, drawn one cell too far to the right in the aerial map, which goes on beyond the ground map.
  const auto mapOf = [](int border, const std::vector<float>& row) {
    HeightMap map;
    map.resolution = 1;
    map.origin_x = map.origin_y = -border;
    map.width = 8 + 2 * border;
    map.height = 1 + 2 * border;
    for (int r = 0; r < map.height; ++r)
      for (int c = 0; c < map.width; ++c)
        map.heights.push_back(row[static_cast<std::size_t>(std::clamp(c - border, 0, 7))]);
    return map;
  };
  const HeightMap ground = mapOf(0, {0, 0, 0, 0, 1, 1, 1, 1});
  HeightMap air = mapOf(3, {5, 5, 5, 5, 5, 6, 6, 6});
  const auto cost = [&](int edge) {
    return zmssdReference(air, ground, Eigen::Vector2d::Zero(), {0, 0, 0}, {0.5, 0}, edge).cost;
  };
  // Less its mean d is 0.125, but at cell 4, where it is -0.875.
  EXPECT_NEAR(cost(0), (7 * 0.125 * 0.125 + 0.875 * 0.875) / 16, 1e-9);
  // Cells 4 and 5 may be either; the others differ by 0.125 all, which is the mean.
  EXPECT_NEAR(cost(1), 0, 1e-9);
  // Where the aerial map shows floor alone, the box is missed as much as before.
  air = mapOf(3, {5, 5, 5, 5, 5, 5, 5, 5});
  EXPECT_NEAR(cost(1), cost(0), 1e-9);
  // And a step within the noise is none.
  air = mapOf(3, {5, 5.05f, 5, 5.05f, 5, 5.05f, 5, 5.05f});
  EXPECT_NEAR(cost(1), cost(0), 1e-9);
  // Where the aerial map ends its last cell may be higher, as the ground map has it, and no other.
  air = mapOf(3, {5, 5, 5, 5, 5, kHole, kHole, kHole});
  EXPECT_GT(cost(0), 0.05);
  EXPECT_NEAR(cost(2), 0, 1e-9);
  air = mapOf(3, {5, 5, 5, 5, 5, 5, kHole, kHole});
  EXPECT_GT(cost(2), 0.05);
}

class KernelMatchesReference : public ::testing::TestWithParam<Cells> {};

TEST_P(KernelMatchesReference, AtRandomPoses) {
  const MapPair maps(GetParam());
  const auto cells = aerialCells(maps.air, kReference, GetParam().edge);
  const DirectCost direct(maps.ground);
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> x(-1.5, 3.6), y(2, 5.3), yaw(-4, 4);
  const CostSettings settings{0.3, 0.01, 0.4, 0.05};
  std::vector<PlanarPose> poses;
  for (int i = 0; i < 300; ++i) poses.push_back({x(random), y(random), yaw(random)});
  const auto fast = direct(cells, poses, settings);
  int finite = 0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const auto slow = zmssdReference(maps.air, maps.ground, kReference, poses[i], settings, GetParam().edge);
    // Single precision may put a cell whose centre lies on a border into the neighbour.
    if (std::isinf(slow.cost) || std::isinf(fast[i].cost)) {
      EXPECT_NEAR(slow.overlap, fast[i].overlap, 4);
      continue;
    }
    ++finite;
    EXPECT_NEAR(fast[i].overlap, slow.overlap, 4);
    EXPECT_NEAR(fast[i].cost, slow.cost, 2e-3 * slow.cost + 1e-6);
    EXPECT_NEAR(fast[i].score, slow.score, 2e-3 * slow.score + 1e-5);
    EXPECT_NEAR(fast[i].dz, slow.dz, 1e-3);
    EXPECT_NEAR(fast[i].relief_air, slow.relief_air, 1e-3);
    EXPECT_NEAR(fast[i].relief_ground, slow.relief_ground, 1e-3);
    EXPECT_NEAR(fast[i].explained, slow.explained, 1e-2);
  }
  EXPECT_GT(finite, 60);
}
INSTANTIATE_TEST_SUITE_P(BoundsAndEdges, KernelMatchesReference, ::testing::ValuesIn(kKindsOfCells));

TEST(Zmssd, ChangeOfReferenceKeepsThePlacement) {
  const auto ground = randomMap(97, 61, 1, 0.1), air = randomMap(43, 37, 2, 0.1);
  const PlanarPose pose{3.4, 1.9, 1.2};
  const Eigen::Vector2d a(0.3, 0.1), b(-1.7, 0.9);
  const CostSettings settings{0.1, 0};
  // Rounding may put a cell whose centre lies on a border into the neighbour.
  const double cost = zmssdReference(air, ground, a, pose, settings).cost;
  ASSERT_TRUE(std::isfinite(cost));
  EXPECT_NEAR(zmssdReference(air, ground, b, changeReference(pose, a, b), settings).cost, cost, 1e-2 * cost);
}

class FftMatchesReference : public ::testing::TestWithParam<int> {};

TEST_P(FftMatchesReference, AtEveryOffset) {
  const int seed = GetParam();
  auto ground = randomMap(71 + 3 * seed, 53 - 2 * seed, 10 + seed, 0.25);
  // Not square: as if turned already, with its own origin.
  auto air = randomMap(26 + seed, 37, 20 + seed, 0.3);
  air.origin_x = -0.8;
  air.origin_y = -0.6;
  // Bounds in both, in one and in none.
  if (seed >= 6) ground = withBounds(ground, 30 + seed, seed == 7 ? 0 : 0.4);
  if (seed >= 6) air = withBounds(air, 40 + seed, seed == 8 ? 0 : 0.3);
  const CostSettings settings{0.5, seed % 2 ? 0.02 : 0.0, seed % 3 ? 0.4 : 0.0, 0.05};
  const FftCost fft(ground);
  // At headings that keep cells on cells; the opposite one has its own geometry.
  const auto maps = fft.andOpposite(air, 0, settings);
  EXPECT_EQ(maps[0].cost, fft(air, 0, settings).cost);
  EXPECT_NEAR(std::abs(maps[1].yaw), M_PI, 1e-12);
  for (const CostMap& map : maps) {
    EXPECT_EQ(map.width, ground.width + air.width - 1);
    EXPECT_EQ(map.height, ground.height + air.height - 1);
    double largest = 0;
    for (float c : map.cost) {
      if (std::isfinite(c)) largest = std::max<double>(largest, c);
    }
    int finite = 0;
    for (int r = 0; r < map.height; ++r) {
      for (int c = 0; c < map.width; ++c) {
        const auto value = zmssdReference(air, ground, Eigen::Vector2d::Zero(), map.pose(r, c), settings);
        ASSERT_EQ(std::isfinite(value.score), std::isfinite(map.at(r, c))) << map.yaw << ' ' << r << ' ' << c;
        if (!std::isfinite(value.score)) continue;
        ++finite;
        ASSERT_NEAR(map.at(r, c), value.score, 2e-5 * largest) << map.yaw << ' ' << r << ' ' << c;
      }
    }
    EXPECT_GT(finite, 500);
  }
}
INSTANTIATE_TEST_SUITE_P(Seeds, FftMatchesReference, ::testing::Range(0, 10));

// An aerial map in the corner of a grid with room for any heading, and a ground map with nothing at its rims.
TEST(Fft, TransformsAreNoLargerThanTheOverlapAsksFor) {
  auto ground = randomMap(71, 53, 10, 0.25);
  auto air = randomMap(64, 60, 20, 0.3);
  for (int r = 0; r < air.height; ++r)
    for (int c = 0; c < air.width; ++c)
      if (r >= 31 || c < 17 || c >= 45) air.at(r, c) = kHole;
  for (int r = 0; r < ground.height; ++r)
    for (int c = 0; c < 9; ++c) ground.at(r, c) = kHole;
  const CostSettings much{0.7, 0.02, 0.4, 0.05}, little{0.01, 0.02, 0.4, 0.05};
  const FftCost fft(ground);
  const FftSize needed = fft.sizeFor(air, much), most = fft.sizeFor(air, little);
  EXPECT_LE(most.rows, 53 + 31 + 15);  // but for the rounding up
  EXPECT_LE(most.columns, 71 + 28 + 21);
  EXPECT_LT(needed.rows, most.rows);
  EXPECT_LT(needed.columns, most.columns);
  EXPECT_GE(needed.rows, 53);
  EXPECT_GE(needed.columns, 71);
  const auto small = fft.andOpposite(air, 0, much), large = fft.andOpposite(air, 0, much, {200, 200});
  for (int way = 0; way < 2; ++way) {
    int finite = 0;
    for (int r = 0; r < small[way].height; ++r) {
      for (int c = 0; c < small[way].width; ++c) {
        const auto value = zmssdReference(air, ground, Eigen::Vector2d::Zero(), small[way].pose(r, c), much);
        ASSERT_EQ(std::isfinite(value.score), std::isfinite(small[way].at(r, c))) << way << ' ' << r << ' ' << c;
        ASSERT_EQ(std::isfinite(value.score), std::isfinite(large[way].at(r, c))) << way << ' ' << r << ' ' << c;
        if (!std::isfinite(value.score)) continue;
        ++finite;
        ASSERT_NEAR(small[way].at(r, c), value.score, 1e-5);
        ASSERT_NEAR(large[way].at(r, c), value.score, 1e-5);
      }
    }
    EXPECT_GT(finite, 100);
  }
}

TEST(Fft, FiveSmoothSizes) {
  EXPECT_EQ(fiveSmoothSize(1), 1);
  EXPECT_EQ(fiveSmoothSize(7), 8);
  EXPECT_EQ(fiveSmoothSize(226), 240);
  EXPECT_EQ(fiveSmoothSize(480), 480);
  EXPECT_THROW(fiveSmoothSize(0), std::invalid_argument);
}

TEST(Fft, RefusesBoundsOfAnotherCap) {
  const auto ground = withBounds(randomMap(40, 30, 1, 0.1), 2, 0.2);
  auto air = withBounds(randomMap(20, 20, 2, 0.1), 3, 0.2);
  air.cap = 1.5;
  const FftCost fft(ground);
  EXPECT_THROW(fft(air, 0, CostSettings()), std::invalid_argument);
}

TEST(Fft, RefusesOtherResolutionsAndEmptyGround) {
  const auto ground = randomMap(40, 30, 1, 0.1);
  auto air = randomMap(20, 20, 2, 0.1);
  air.resolution = 0.1;
  const FftCost fft(ground);
  EXPECT_THROW(fft(air, 0, CostSettings()), std::invalid_argument);
  auto holes = ground;
  holes.heights.assign(holes.heights.size(), kHole);
  EXPECT_THROW(FftCost{holes}, std::invalid_argument);
  EXPECT_THROW(DirectCost{holes}, std::invalid_argument);
}

struct Cut {
  double x, y, yaw_deg, dz;
};
class SearchRecovers : public ::testing::TestWithParam<Cut> {};

TEST_P(SearchRecovers, OffsetHeadingAndHeight) {
  // Signs and axes: a wrong one lands elsewhere, since the map is neither square nor symmetric.
  const auto p = GetParam();
  const PlanarPose truth{p.x, p.y, p.yaw_deg * M_PI / 180};
  const auto ground = randomMap(130, 90, 7, 0.05);
  const auto air = cutOut(ground, truth, p.dz, 44, 31);
  const CostSettings settings{0.5, 0};
  const FftCost fft(ground);
  const auto volume = computeCostVolume(fft, air, searchHeadings(72, {}), true, settings);
  const auto minima = findLocalMinima(volume, 3, 0.4, 0.3);
  ASSERT_FALSE(minima.empty());
  const auto cells = aerialCells(air, volume.pivot);
  const auto found = descend(DirectCost(ground), cells, minima.front(), 0.05, 0.04, settings);
  const auto origin = changeReference(found.pose, volume.pivot, Eigen::Vector2d::Zero());
  EXPECT_NEAR(origin.x, truth.x, 0.03);
  EXPECT_NEAR(origin.y, truth.y, 0.03);
  EXPECT_NEAR(std::remainder(origin.yaw - truth.yaw, 2 * M_PI), 0, 0.02);
  EXPECT_NEAR(found.agreement.dz, p.dz, 0.02);
}
INSTANTIATE_TEST_SUITE_P(Placements, SearchRecovers,
                         ::testing::Values(Cut{1.2, 4.1, 0, 0.3}, Cut{1.7, 3.6, 33, -1.2}, Cut{2.1, 4.4, 90, 2},
                                           Cut{1.9, 4.5, -128, 0}, Cut{2.6, 4.9, 178, 0.5}));

// However many lower ones lie elsewhere.
TEST(Search, TheMinimaAreThoseThatThePriorAllows) {
  CostVolume volume;
  volume.pivot = {0.5, 0};
  CostMap map;
  map.width = 9;
  map.height = 1;
  map.resolution = 1;
  map.cost = {1, 9, 2, 9, 3, 9, 4, 9, 5};
  volume.slices = {map};
  Prior prior;
  prior.position = Eigen::Vector2d(map.pose(0, 6).x - 0.5, map.pose(0, 6).y);  // of the frame's origin
  prior.position_sigma = 0.7;
  const auto minima = findLocalMinima(volume, 2, 0.4, 0.3, prior);
  ASSERT_EQ(minima.size(), 2u);
  EXPECT_EQ(minima[0].x, map.pose(0, 4).x);
  EXPECT_EQ(minima[1].x, map.pose(0, 6).x);
  EXPECT_EQ(findLocalMinima(volume, 2, 0.4, 0.3)[0].x, map.pose(0, 0).x);
}

TEST(Search, KnownHeadingLimitsTheHeadings) {
  Prior prior;
  prior.yaw = 3.1;
  prior.yaw_sigma = 0.1;
  const auto headings = searchHeadings(72, prior);
  EXPECT_LT(headings.size(), 12u);
  for (double h : headings) EXPECT_LT(std::abs(std::remainder(h - 3.1, 2 * M_PI)), 0.4);
  EXPECT_EQ(searchHeadings(72, {}).size(), 72u);
  EXPECT_GT(prior.logDensity({0, 0, 3.1}, {0, 0}), prior.logDensity({0, 0, -3.0}, {0, 0}));
  prior.position = Eigen::Vector2d(2, 1);
  prior.position_reference = {1, 0};
  // A pose of the origin with heading 90 degrees carries (1, 0) to (x, y + 1).
  Prior only_position = prior;
  only_position.yaw.reset();
  EXPECT_NEAR(only_position.logDensity({2, 0, M_PI / 2}, {0, 0}), 0, 1e-12);
}
