#include "streetview_localizer/features.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

namespace streetview_localizer {
namespace {

/// Gaussian blobs on a grid with sub-pixel offsets: their centres are the truth of the keypoints.
cv::Mat drawBlobs(std::vector<cv::Point2f>* centres) {
  cv::Mat image(240, 320, CV_32F, cv::Scalar(60));
  std::mt19937 random(3);
  std::uniform_real_distribution<float> offset(-0.5f, 0.5f), size(2.5f, 4.f);
  for (int y = 40; y < 220; y += 40) {
    for (int x = 40; x < 300; x += 40) {
      const cv::Point2f c(x + offset(random), y + offset(random));
      const float sigma = size(random);
      for (int v = y - 16; v <= y + 16; ++v)
        for (int u = x - 16; u <= x + 16; ++u)
          image.at<float>(v, u) +=
              150 * std::exp(-((u - c.x) * (u - c.x) + (v - c.y) * (v - c.y)) / (2 * sigma * sigma));
      centres->push_back(c);
    }
  }
  image.convertTo(image, CV_8U);
  return image;
}

class BlobTest : public ::testing::TestWithParam<bool> {};

TEST_P(BlobTest, KeypointsLieOnTheCentresWithoutBias) {
  std::vector<cv::Point2f> centres;
  const cv::Mat image = drawBlobs(&centres);
  FeatureSettings settings;
  settings.double_image = GetParam();
  const Features features = extractFeatures(image, settings);
  cv::Point2f bias(0, 0);
  float found = 0;
  for (const cv::Point2f& c : centres) {
    cv::Point2f nearest(1e3f, 1e3f);
    for (const cv::KeyPoint& k : features.keypoints)
      if (cv::norm(k.pt - c) < cv::norm(nearest)) nearest = k.pt - c;
    if (cv::norm(nearest) > 10) continue;  // a peak shared by two equal pixels is no extremum
    EXPECT_LT(cv::norm(nearest), 0.25);
    bias += nearest;
    ++found;
  }
  ASSERT_GT(found, 0.8f * centres.size());
  bias *= 1 / found;
  EXPECT_LT(std::abs(bias.x), 0.04);
  EXPECT_LT(std::abs(bias.y), 0.04);
}
INSTANTIATE_TEST_SUITE_P(Doubled, BlobTest, ::testing::Bool());

TEST(RootSift, DistanceIsHellingersTimes512Sqrt2) {
  std::mt19937 random(5);
  std::exponential_distribution<float> value(1.f / 20);
  cv::Mat sift(200, 128, CV_32F);
  for (int i = 0; i < sift.rows; ++i)
    for (int j = 0; j < sift.cols; ++j) sift.at<float>(i, j) = std::floor(value(random));
  const cv::Mat root = rootSift(sift);
  ASSERT_EQ(root.type(), CV_8U);
  for (int i = 1; i < sift.rows; ++i) {
    const double sum_a = cv::sum(sift.row(i - 1))[0], sum_b = cv::sum(sift.row(i))[0];
    double hellinger2 = 0;
    for (int j = 0; j < sift.cols; ++j) {
      const double d = std::sqrt(sift.at<float>(i - 1, j) / sum_a) - std::sqrt(sift.at<float>(i, j) / sum_b);
      hellinger2 += 0.5 * d * d;
    }
    EXPECT_NEAR(cv::norm(root.row(i - 1), root.row(i), cv::NORM_L2), 512 * std::sqrt(2 * hellinger2), 3);
  }
}

TEST(RootSift, HasTheSameLengthForEveryDescriptor) {
  std::vector<cv::Point2f> centres;
  const Features features = extractFeatures(drawBlobs(&centres));
  ASSERT_GT(features.size(), 20u);
  for (int i = 0; i < features.descriptors.rows; ++i) EXPECT_NEAR(cv::norm(features.descriptors.row(i)), 512, 8);
}

TEST(Features, AreTheSameEveryTimeAndObeyMaskAndLimit) {
  std::vector<cv::Point2f> centres;
  const cv::Mat image = drawBlobs(&centres);
  const Features a = extractFeatures(image), b = extractFeatures(image);
  ASSERT_EQ(a.size(), b.size());
  EXPECT_EQ(cv::norm(a.descriptors, b.descriptors, cv::NORM_INF), 0);
  cv::Mat mask(image.size(), CV_8U, cv::Scalar(0));
  mask(cv::Rect(0, 0, 160, 240)).setTo(255);
  const Features left = extractFeatures(image, {}, mask);
  EXPECT_GT(left.size(), 5u);
  for (const cv::KeyPoint& k : left.keypoints) EXPECT_LT(k.pt.x, 161);
  FeatureSettings few;
  few.max_features = 10;
  EXPECT_LE(extractFeatures(image, few).size(), 12u);
}

TEST(Features, NothingInBlankSmallOrEmptyImages) {
  EXPECT_EQ(extractFeatures(cv::Mat(240, 320, CV_8U, cv::Scalar(0))).size(), 0u);
  EXPECT_EQ(extractFeatures(cv::Mat(8, 8, CV_8U, cv::Scalar(9))).size(), 0u);
  EXPECT_EQ(extractFeatures(cv::Mat()).size(), 0u);
  EXPECT_THROW(extractFeatures(cv::Mat(240, 320, CV_32F)), std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
