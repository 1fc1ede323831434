// Depth edges of the plane sweep.
#include "../src/other_surfaces.h"

#include <gtest/gtest.h>

#include <limits>
#include <opencv2/core.hpp>
#include <random>

namespace dense_fusion {
namespace {

constexpr int kSize = 24, kEdge = 12, kRow = 7;
constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

/// The left half lies 1 m away, the right half 2 m.
struct Step {
  cv::Mat depth{kSize, kSize, CV_32F, cv::Scalar(2)}, cost{kSize, kSize, CV_32F, cv::Scalar(10)};
  Step() { depth.colRange(0, kEdge) = 1; }
  int other(int x) const { return otherSurfaces(depth, cost, 2, 2).at<int>(kRow, x); }
};

int index(int x, int y) { return y * kSize + x; }

TEST(OtherSurfaces, AreThoseOfTheNeighbourWhoseWindowCostsLeast) {
  Step step;
  step.cost.at<float>(kRow - 1, kEdge + 1) = 5;
  step.cost.at<float>(kRow + 2, kEdge - 1) = 4;
  EXPECT_EQ(step.other(kEdge - 1), index(kEdge + 1, kRow - 1));
  EXPECT_EQ(step.other(kEdge), index(kEdge - 1, kRow + 2));
  EXPECT_EQ(step.other(kEdge + 1), index(kEdge - 1, kRow + 2));
  for (const int x : {0, kEdge - 3, kEdge + 2, kSize - 1}) EXPECT_EQ(step.other(x), -1) << x;
}

TEST(OtherSurfaces, ASlopeIsOneSurfaceAndTheUnknownNone) {
  Step step;
  for (int x = 0; x < kSize; ++x) step.depth.col(x) = 2 + 0.015 * x;
  for (int x = 0; x < kSize; ++x) EXPECT_EQ(step.other(x), -1) << x;
  Step gap;
  gap.depth.colRange(kEdge, kEdge + 2) = kUnknown;
  gap.cost.colRange(kEdge, kEdge + 2) = 0;
  for (const int x : {kEdge - 1, kEdge, kEdge + 1, kEdge + 2}) EXPECT_EQ(gap.other(x), -1) << x;
}

TEST(OtherSurfaces, AreThoseOfAPlainSearch) {
  std::mt19937 random(5);
  Step step;
  for (int i = 0; i < kSize * kSize; ++i) {
    step.depth.ptr<float>()[i] = random() % 9 == 0 ? kUnknown : 1.f + 0.01f * static_cast<float>(random() % 5);
    step.cost.ptr<float>()[i] = static_cast<float>(random());
  }
  const cv::Mat others = otherSurfaces(step.depth, step.cost, 2, 1);
  for (int i = 0; i < kSize * kSize; ++i) {
    int expected = -1;
    for (int k = 0; k < kSize * kSize; ++k) {
      const bool near = std::abs(k % kSize - i % kSize) <= 2 && std::abs(k / kSize - i / kSize) <= 2;
      const float a = step.depth.ptr<float>()[i], b = step.depth.ptr<float>()[k];
      if (near && std::abs(b - a) >= 0.02f * a &&
          (expected < 0 || step.cost.ptr<float>()[k] < step.cost.ptr<float>()[expected]))
        expected = k;
    }
    ASSERT_EQ(others.ptr<int>()[i], expected) << i;
  }
}

}  // namespace
}  // namespace dense_fusion
