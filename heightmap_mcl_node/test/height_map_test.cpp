#include "heightmap_mcl/height_map.h"

#include <gtest/gtest.h>

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

TEST(HeightMap, RotationTurnsCounterClockwiseAboutThePivot) {
  const auto map = buildHeightMap({{1.05f, 2.05f, 1.f}, {1.55f, 2.05f, 7.f}}, plain());
  // The higher cell lies half a metre along +x of the pivot; turned by 90 degrees it lies along +y.
  const auto turned = rotateAbout(map, {1.0, 2.0}, M_PI / 2, 20);
  EXPECT_FLOAT_EQ(heightAt(turned, -0.05, 0.55), 7.f);
  EXPECT_TRUE(std::isnan(heightAt(turned, 0.05, -0.55)));
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
