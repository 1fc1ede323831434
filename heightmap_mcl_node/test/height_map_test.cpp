#include "heightmap_mcl/height_map.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

using namespace heightmap_mcl;

namespace {

HeightMapSettings plain() {
  HeightMapSettings s;
  s.resolution = 0.1;
  s.dilation = Dilation::kNone;
  return s;
}

/// Height at a point; NaN outside.
float heightAt(const HeightMap& map, double x, double y) {
  const int c = static_cast<int>(std::floor((x - map.origin_x) / map.resolution));
  const int r = static_cast<int>(std::floor((y - map.origin_y) / map.resolution));
  if (c < 0 || r < 0 || c >= map.width || r >= map.height) return kHole;
  return map.at(r, c);
}

}  // namespace

TEST(HeightMap, KeepsTheHighestPointAtTheRightPlace) {
  // Asymmetric on purpose: swapped axes or a flipped sign would show.
  const auto map = buildHeightMap(
      {{1.25f, -0.35f, 0.2f}, {1.27f, -0.33f, 0.7f}, {1.22f, -0.31f, 0.4f}, {-0.55f, 0.05f, 0.1f}}, plain());
  EXPECT_FLOAT_EQ(heightAt(map, 1.25, -0.35), 0.7f);
  EXPECT_FLOAT_EQ(heightAt(map, -0.55, 0.05), 0.1f);
  EXPECT_TRUE(std::isnan(heightAt(map, -0.35, 1.25)));
  EXPECT_EQ(map.defined(), 2u);
  EXPECT_GT(map.width, map.height);
  // Cells lie at whole multiples of the resolution.
  EXPECT_NEAR(std::remainder(map.origin_x, map.resolution), 0, 1e-9);
  EXPECT_NEAR(std::remainder(map.origin_y, map.resolution), 0, 1e-9);
}

TEST(HeightMap, IgnoresPointsThatAreNotFinite) {
  const float nan = std::nanf(""), inf = std::numeric_limits<float>::infinity();
  const auto map = buildHeightMap({{0, 0, nan}, {nan, 0, 1}, {0, inf, 1}, {0.05f, 0.05f, 0.3f}}, plain());
  EXPECT_EQ(map.defined(), 1u);
  EXPECT_TRUE(buildHeightMap({{nan, 0, 0}}, plain()).empty());
  EXPECT_TRUE(buildHeightMap({}, plain()).empty());
}

TEST(HeightMap, FarOutlierDoesNotBlowUpTheGrid) {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 100; ++i) points.emplace_back(0.01f * i, 0.02f * i, 0.f);
  points.emplace_back(1e6f, -1e6f, 5.f);
  const auto map = buildHeightMap(points, plain());
  EXPECT_LT(map.width, 20);
  EXPECT_LT(map.height, 30);
}

TEST(HeightMap, OfALargeCloudTheDensestRegionStaysAndTheRestIsCounted) {
  // A robot that drove round a block: the median of each axis lies where nothing is.
  auto settings = plain();
  settings.max_extent = 20;
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 3600; ++i) {
    const float a = static_cast<float>(i * M_PI / 1800);
    points.emplace_back(50 * std::cos(a), 50 * std::sin(a), 1.f);
  }
  for (int i = 0; i < 200; ++i) points.emplace_back(0.01f * i - 1, 50.f, 2.f);
  std::size_t cropped = 0;
  const auto map = buildHeightMap(points, settings, &cropped);
  EXPECT_FLOAT_EQ(heightAt(map, 0, 50.05), 2.f);
  EXPECT_LE(map.width, 203);
  EXPECT_LE(map.height, 203);
  EXPECT_GT(cropped, 2500u);
  EXPECT_LT(cropped, 3800u);
  // Within the extent nothing is left out.
  settings.max_extent = 150;
  EXPECT_GT(buildHeightMap(points, settings, &cropped).defined(), 1000u);
  EXPECT_EQ(cropped, 0u);
}

TEST(HeightMap, WithoutADefinedCellItIsEmpty) {
  auto settings = plain();
  settings.min_points = 3;
  EXPECT_TRUE(buildHeightMap({{0, 0, 1}, {1, 0, 1}, {0, 1, 1}}, settings).empty());
}

TEST(HeightMap, UnionExtent) {
  const auto a = buildHeightMap({{0.05f, 0.05f, 1.f}}, plain()), b = buildHeightMap({{5.05f, 1.05f, 1.f}}, plain());
  EXPECT_NEAR(unionExtent({&a}), 0.3, 1e-9);  // with its border
  EXPECT_NEAR(unionExtent({&a, &b}), 5.3, 1e-9);
  EXPECT_EQ(unionExtent({}), 0);
}

TEST(HeightMap, QuantileSupportAndSpikeFilterDropOutliers) {
  std::vector<Eigen::Vector3f> points;
  for (int x = 0; x < 5; ++x) {
    for (int y = 0; y < 5; ++y) {
      for (int k = 0; k < 10; ++k) points.emplace_back(0.1f * x + 0.05f, 0.1f * y + 0.05f, 0.01f * k);
    }
  }
  points.emplace_back(0.25f, 0.25f, 3.f);
  auto settings = plain();
  EXPECT_FLOAT_EQ(heightAt(buildHeightMap(points, settings), 0.25, 0.25), 3.f);
  settings.height_quantile = 0.9;
  EXPECT_NEAR(heightAt(buildHeightMap(points, settings), 0.25, 0.25), 0.09f, 1e-6);
  settings.height_quantile = 1;
  settings.max_spike = 0.5;
  EXPECT_TRUE(std::isnan(heightAt(buildHeightMap(points, settings), 0.25, 0.25)));
  points.emplace_back(0.95f, 0.95f, 0.f);
  settings.min_points = 2;
  EXPECT_TRUE(std::isnan(heightAt(buildHeightMap(points, settings), 0.95, 0.95)));
}

TEST(HeightMap, DilationFillsHolesWithTheHighestNeighbour) {
  const auto map = buildHeightMap({{0.05f, 0.05f, 1.f}, {0.25f, 0.05f, 2.f}}, plain());
  const auto all = dilate(map, Dilation::kAll), holes = dilate(map, Dilation::kHoles);
  EXPECT_FLOAT_EQ(heightAt(all, 0.15, 0.05), 2.f);
  EXPECT_FLOAT_EQ(heightAt(holes, 0.15, 0.05), 2.f);
  EXPECT_FLOAT_EQ(heightAt(all, 0.35, 0.15), 2.f);
  EXPECT_TRUE(std::isnan(heightAt(all, 0.45, 0.05)));
  // Two cells side by side: only the paper's dilation raises the lower one.
  const auto pair = buildHeightMap({{0.05f, 0.05f, 1.f}, {0.15f, 0.05f, 2.f}}, plain());
  EXPECT_FLOAT_EQ(heightAt(dilate(pair, Dilation::kAll), 0.05, 0.05), 2.f);
  EXPECT_FLOAT_EQ(heightAt(dilate(pair, Dilation::kHoles), 0.05, 0.05), 1.f);
}

TEST(HeightMap, MergeKeepsPlacesAndHeights) {
  const auto a = buildHeightMap({{0.05f, 0.05f, 1.f}, {0.15f, 0.05f, 2.f}}, plain());
  const auto b = buildHeightMap({{0.05f, 0.05f, 3.f}, {-1.05f, 2.05f, 4.f}}, plain());
  const auto highest = merge({&a, &b}, Merge::kHighest), mean = merge({&a, &b}, Merge::kMean);
  EXPECT_FLOAT_EQ(heightAt(highest, 0.05, 0.05), 3.f);
  EXPECT_FLOAT_EQ(heightAt(mean, 0.05, 0.05), 2.f);
  EXPECT_FLOAT_EQ(heightAt(mean, -1.05, 2.05), 4.f);
  EXPECT_FLOAT_EQ(heightAt(highest, 0.15, 0.05), 2.f);
  auto other = plain();
  other.resolution = 0.2;
  const auto coarse = buildHeightMap({{0, 0, 1}}, other);
  EXPECT_THROW(merge({&a, &coarse}, Merge::kMean), std::invalid_argument);
  EXPECT_TRUE(merge({}, Merge::kMean).empty());
}

TEST(HeightMap, DownsampleKeepsTheHighestOfEachBlockAtNegativeCoordinatesToo) {
  const auto map = buildHeightMap({{-0.05f, -0.05f, 1.f}, {-0.15f, -0.15f, 2.f}, {0.05f, 0.05f, 0.5f}}, plain());
  const auto half = downsample(map, 2);
  EXPECT_DOUBLE_EQ(half.resolution, 0.2);
  EXPECT_FLOAT_EQ(heightAt(half, -0.1, -0.1), 2.f);
  EXPECT_FLOAT_EQ(heightAt(half, 0.1, 0.1), 0.5f);
  EXPECT_EQ(half.defined(), 2u);
}

TEST(HeightMap, ScalingMovesCellsAndHeights) {
  const auto map = buildHeightMap({{1.05f, -2.05f, 1.f}, {-0.55f, 0.35f, 0.4f}}, plain());
  const auto larger = scaled(map, 2);
  EXPECT_FLOAT_EQ(heightAt(larger, 2.1, -4.1), 2.f);
  EXPECT_FLOAT_EQ(heightAt(larger, -1.1, 0.7), 0.8f);
  EXPECT_TRUE(std::isnan(heightAt(larger, 1.05, -2.05)));
  EXPECT_FLOAT_EQ(heightAt(scaled(larger, 0.5), 1.05, -2.05), 1.f);
}

TEST(HeightMap, RotationTurnsCounterClockwiseAboutThePivot) {
  const auto map = buildHeightMap({{1.05f, 2.05f, 1.f}, {1.55f, 2.05f, 7.f}}, plain());
  // The higher cell lies half a metre along +x of the pivot; turned by 90 degrees it lies along +y.
  const auto turned = rotateAbout(map, {1.0, 2.0}, M_PI / 2, 20);
  EXPECT_FLOAT_EQ(heightAt(turned, -0.05, 0.55), 7.f);
  EXPECT_TRUE(std::isnan(heightAt(turned, 0.05, -0.55)));
}

namespace {

/// Points of a room of 3x2 m with cells of 0.1 m: a floor at z = -1.3 m, and what each test adds.
std::vector<Eigen::Vector3f> floorPoints() {
  std::vector<Eigen::Vector3f> points;
  for (float x = 0.05f; x < 3; x += 0.1f) {
    for (float y = 0.05f; y < 2; y += 0.1f) points.emplace_back(x, y, -1.3f + 0.004f * std::sin(7 * x + 5 * y));
  }
  return points;
}
void addColumn(std::vector<Eigen::Vector3f>& points, float x, float y, float from, float to) {
  for (float z = from; z <= to; z += 0.05f) points.emplace_back(x, y, -1.3f + z);
}
void addSurface(std::vector<Eigen::Vector3f>& points, float x0, float x1, float y0, float y1, float z) {
  for (float x = x0; x < x1; x += 0.1f) {
    for (float y = y0; y < y1; y += 0.1f) points.emplace_back(x, y, -1.3f + z);
  }
}
HeightMapSettings bounded() {
  HeightMapSettings s = plain();
  s.tops = Tops::kBounded;
  return s;
}
bool boundAt(const HeightMap& map, double x, double y) {
  const int c = static_cast<int>(std::floor((x - map.origin_x) / map.resolution));
  const int r = static_cast<int>(std::floor((y - map.origin_y) / map.resolution));
  return map.isBound(static_cast<std::size_t>(r) * map.width + c);
}

}  // namespace

TEST(Floor, IsTheLowestLargeSurface) {
  auto points = floorPoints();
  addSurface(points, 0.05f, 3, 0.05f, 2, 0.72f);  // tables everywhere
  addSurface(points, 0.05f, 3, 0.05f, 2, 2.5f);   // ceiling
  addColumn(points, 1.05f, 1.05f, -0.9f, -0.2f);  // mirrored below the floor
  points.emplace_back(0.05f, 0.05f, -1e7f);
  const auto map = buildHeightMap(points, bounded());
  EXPECT_NEAR(map.floor, -1.3, 0.02);
  // What is seen of a table alone takes its floor from the earlier maps.
  std::vector<Eigen::Vector3f> table;
  addSurface(table, 0.05f, 1, 0.05f, 1, 0.72f);
  EXPECT_NEAR(buildHeightMap(table, bounded()).floor, -0.58, 0.02);
  EXPECT_NEAR(buildHeightMap(table, bounded(), nullptr, &map.levels).floor, -1.3, 0.02);
  EXPECT_TRUE(std::isnan(findFloor({})));
  // The table may be any of the surfaces that the other map has: its floor, or its table of 0.72 m.
  const auto floors = floorCandidates(buildHeightMap(table, bounded()).levels, map.levels, map.cap, 4);
  ASSERT_EQ(floors.size(), 2u);
  EXPECT_NEAR(floors[0], -0.58, 0.02);
  EXPECT_NEAR(floors[1], -1.3, 0.02);
  EXPECT_EQ(floorCandidates(map.levels, map.levels, map.cap, 4).size(), 1u);  // nothing may lie below a floor
}

TEST(Columns, AWallIsABoundWhereverTheViewEnded) {
  auto points = floorPoints();
  for (float y = 0.05f; y < 1; y += 0.1f) addColumn(points, 2.95f, y, 0.1f, 0.6f);
  for (float y = 1.05f; y < 2; y += 0.1f) addColumn(points, 2.95f, y, 0.1f, 2.2f);
  const auto map = buildHeightMap(points, bounded());
  EXPECT_TRUE(boundAt(map, 2.95, 0.55));
  EXPECT_NEAR(heightAt(map, 2.95, 0.55), -0.7, 0.06);
  EXPECT_TRUE(boundAt(map, 2.95, 1.55));
  EXPECT_NEAR(heightAt(map, 2.95, 1.55), map.floor + 1, 1e-5);  // the cap
  EXPECT_FALSE(boundAt(map, 1.05, 1.05));
}

TEST(Columns, ABoxSeenFromAboveHasAHeight) {
  auto points = floorPoints();
  points.erase(std::remove_if(points.begin(), points.end(),
                              [](const auto& p) { return p.x() > 1 && p.x() < 1.9f && p.y() > 0.5f && p.y() < 1.4f; }),
               points.end());
  addSurface(points, 1.05f, 1.9f, 0.55f, 1.4f, 0.8f);
  for (float y = 0.55f; y < 1.4f; y += 0.1f) addColumn(points, 1.05f, y, 0.1f, 0.8f);
  const auto map = buildHeightMap(points, bounded());
  EXPECT_FALSE(boundAt(map, 1.55, 0.95));
  EXPECT_FALSE(boundAt(map, 1.05, 0.95));
  EXPECT_NEAR(heightAt(map, 1.05, 0.95), -0.5, 0.01);
}

TEST(Columns, CeilingLampLintelAndTableFromBelowAreNoHeights) {
  auto points = floorPoints();
  addSurface(points, 0.05f, 3, 0.05f, 2, 2.5f);
  for (float x = 0.25f; x < 0.5f; x += 0.1f) addColumn(points, x, 0.35f, 1.8f, 2.0f);   // lamp over the floor
  for (float y = 0.85f; y < 1.7f; y += 0.1f) addColumn(points, 2.95f, y, 2.0f, 2.45f);  // lintel over an open door
  addSurface(points, 1.05f, 1.8f, 0.55f, 1.2f, 0.7f);                                   // a table, its floor seen too
  addSurface(points, 4.05f, 4.6f, 0.05f, 1.0f, 2.5f);                                   // ceiling over nothing seen
  auto settings = bounded();
  settings.drop_hanging = true;
  const auto map = buildHeightMap(points, settings);
  for (const auto& p : {Eigen::Vector2d(0.35, 0.35), Eigen::Vector2d(2.95, 1.25), Eigen::Vector2d(2.05, 1.85)}) {
    EXPECT_NEAR(heightAt(map, p.x(), p.y()), -1.3, 0.02) << p.transpose();
    EXPECT_FALSE(boundAt(map, p.x(), p.y())) << p.transpose();
  }
  EXPECT_TRUE(boundAt(map, 1.45, 0.85));
  EXPECT_NEAR(heightAt(map, 1.45, 0.85), -0.6, 0.01);
  EXPECT_TRUE(std::isnan(heightAt(map, 4.35, 0.55)));
  // From above, what stands over nothing seen is the top of something that high.
  settings.drop_hanging = false;
  EXPECT_TRUE(boundAt(buildHeightMap(points, settings), 4.35, 0.55));
  // The plain clip takes them all for 1 m, the paper for what they are.
  settings.tops = Tops::kClipped;
  EXPECT_NEAR(heightAt(buildHeightMap(points, settings), 2.05, 1.85), -0.3, 0.02);
  settings.tops = Tops::kHighest;
  EXPECT_NEAR(heightAt(buildHeightMap(points, settings), 2.05, 1.85), 1.2, 0.02);
}

// Floor of which a table hides what is above, seen by the ground robot: with its underside, whose edge was seen, or
// not.
TEST(Columns, FloorBelowATableSaysNothingOfTheTable) {
  std::vector<Eigen::Vector3f> points;
  std::vector<float> hidden;
  const auto add = [&](float x, float z, float from) {
    points.emplace_back(x, 0.005f, z);
    hidden.push_back(from);
  };
  const float nothing = std::numeric_limits<float>::quiet_NaN();
  add(0.005f, 0.f, 0.7f);  // the floor below the table
  add(0.105f, 0.f, 0.7f);  // and where the table was seen from below, and the ceiling
  add(0.105f, 0.71f, nothing);
  add(0.205f, 0.f, 0.7f);  // and where the ceiling alone was
  add(0.205f, 2.4f, nothing);
  add(0.305f, 0.f, nothing);  // the open floor
  const auto left = withoutHiddenTops(points, hidden, 0.02);
  ASSERT_EQ(left.size(), 4u);
  EXPECT_EQ(left[0], points[1]);
  EXPECT_EQ(left[1], points[2]);
  EXPECT_EQ(left[2], points[4]);
  EXPECT_EQ(left[3], points[5]);
  EXPECT_THROW(withoutHiddenTops(points, {nothing}, 0.02), std::invalid_argument);
  points[0].x() = nothing;
  EXPECT_EQ(withoutHiddenTops(points, hidden, 0.02).size(), 5u) << "not finite: for buildHeightMap to leave out";
}

TEST(Columns, MergingPrefersHeightsAndTheHighestBound) {
  HeightMap a;
  a.resolution = 0.1;
  a.width = 4;
  a.height = 1;
  a.floor = 0;
  a.cap = 1;
  a.levels.cells = {100};
  auto b = a;
  a.heights = {0.5f, 0.4f, 0.0f, 0.7f};
  a.bounds = {1, 1, 0, 0};
  b.heights = {0.8f, 0.6f, 0.6f, 0.8f};
  b.bounds = {1, 0, 1, 0};
  const auto merged = merge({&a, &b}, Merge::kMean);
  EXPECT_FLOAT_EQ(merged.heights[0], 0.8f);  // both bounds: the higher one
  EXPECT_FLOAT_EQ(merged.heights[1], 0.6f);  // a height above the bound
  EXPECT_FLOAT_EQ(merged.heights[2], 0.6f);  // a bound that a height contradicts
  EXPECT_FLOAT_EQ(merged.heights[3], 0.75f);
  EXPECT_EQ(merged.bounds, (std::vector<std::uint8_t>{1, 0, 1, 0}));
  // Coarser cells keep the flag of what is highest.
  EXPECT_EQ(boundLevel(merged, 0), 3);
  EXPECT_EQ(boundLevel(merged, 1), 0);
}

TEST(HeightMap, BadSettingsAreNamed) {
  auto s = plain();
  s.height_quantile = 0;
  try {
    buildHeightMap({{0, 0, 0}}, s);
    FAIL();
  } catch (const std::invalid_argument& e) {
    EXPECT_NE(std::string(e.what()).find("height_quantile"), std::string::npos);
  }
}

TEST(HeightMap, RaisedShareCountsWhatStandsOnTheFloor) {
  HeightMap map;
  map.width = 5;
  map.height = 1;
  map.floor = 1;
  map.heights = {1.f, 1.05f, 1.3f, std::nanf(""), 1.09f};
  EXPECT_DOUBLE_EQ(raisedShare(map, 0.08), 0.5);
  EXPECT_DOUBLE_EQ(raisedShare(map, 1), 0);
  EXPECT_DOUBLE_EQ(raisedShare(HeightMap(), 0.08), 0);
}
