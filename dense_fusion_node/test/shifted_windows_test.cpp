// Depth edges of the plane sweep.
#include "../src/shifted_windows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace dense_fusion {
namespace {

constexpr int kSize = 24, kEdge = 12;
constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

/// The left half lies 1 m away, the right half 2 m; `spill` columns of it have got the left one's depth, at a high
/// cost.
struct Step {
  cv::Mat cost{kSize, kSize, CV_32F, cv::Scalar(10)};
  DepthMap map;

  explicit Step(int spill) {
    map.depth = cv::Mat(kSize, kSize, CV_32F, cv::Scalar(2));
    map.confidence = cv::Mat(kSize, kSize, CV_32F, cv::Scalar(0.5));
    map.depth.colRange(0, kEdge + spill) = 1;
    map.confidence.colRange(0, kEdge + spill) = 0.9;
    cost.colRange(kEdge, kEdge + spill) = 30;
  }
  float depthAt(int x) const { return map.depth.at<float>(kSize / 2, x); }
};

TEST(ShiftedWindows, TakeBackWhatSpillsOverAnEdge) {
  Step step(2);
  // Windows on the left, one of whose columns lies beyond the edge, are not better than those that see the right alone.
  step.cost.colRange(kEdge - 2, kEdge) = 20;
  takeBestWindows(step.cost, 2, 1, &step.map);
  for (int x = 0; x < kSize; ++x) EXPECT_EQ(step.depthAt(x), x < kEdge ? 1 : 2) << x;
  EXPECT_EQ(step.map.confidence.at<float>(5, kEdge), 0.5f) << "of the window that was taken";
}

TEST(ShiftedWindows, NoFurtherThanTheirRadius) {
  Step step(6);
  takeBestWindows(step.cost, 2, 1, &step.map);
  for (int x = 0; x < kSize; ++x) EXPECT_EQ(step.depthAt(x), x < kEdge + 4 ? 1 : 2) << x;
}

TEST(ShiftedWindows, AnEdgeBetweenEqualCostsStays) {
  Step step(0);
  step.cost.colRange(0, kEdge) = 11;  // a little worse is not worse
  takeBestWindows(step.cost, 2, 1, &step.map);
  for (int x = 0; x < kSize; ++x) EXPECT_EQ(step.depthAt(x), x < kEdge ? 1 : 2) << x;
}

TEST(ShiftedWindows, OnASlopeEachKeepsItsOwn) {
  Step step(0);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      step.map.depth.at<float>(y, x) = 2 + 0.015f * static_cast<float>(x);
      step.cost.at<float>(y, x) = static_cast<float>(1 + (7 * x + 3 * y) % 5);
    }
  const cv::Mat before = step.map.depth.clone();
  takeBestWindows(step.cost, 2, 2, &step.map);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) EXPECT_EQ(step.map.depth.at<float>(y, x), before.at<float>(y, x));
}

TEST(ShiftedWindows, WhatIsUnknownStaysAndTellsNothing) {
  Step step(2);
  step.map.depth.colRange(kEdge + 2, kSize) = kUnknown;
  step.cost.colRange(kEdge + 2, kSize) = 0;
  step.map.depth.at<float>(3, 3) = kUnknown;
  step.cost.at<float>(3, 3) = -1;
  takeBestWindows(step.cost, 2, 1, &step.map);
  for (int x = 0; x < kEdge + 2; ++x) EXPECT_EQ(step.depthAt(x), 1) << x;
  EXPECT_TRUE(std::isnan(step.depthAt(kEdge + 2)));
  EXPECT_TRUE(std::isnan(step.map.depth.at<float>(3, 3)));
}

}  // namespace
}  // namespace dense_fusion
