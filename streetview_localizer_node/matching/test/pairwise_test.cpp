#include "streetview_localizer/pairwise.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "../src/distance_kernel.h"

namespace streetview_localizer {
namespace {

void fillDescriptor(std::mt19937& random, int largest, cv::Mat row) {
  std::uniform_int_distribution<int> value(0, largest);
  for (int e = 0; e < 128; ++e) row.at<unsigned char>(0, e) = static_cast<unsigned char>(value(random));
}

/// Random places and descriptors; the first `common` of both lists have the same descriptors up to noise, and every
/// third of the query is there twice at nearly the same place.
void makePair(std::mt19937& random, int nq, int nv, int common, Features* query, Features* view) {
  std::uniform_real_distribution<float> u(0, 600);
  query->descriptors.create(nq, 128, CV_8U);
  view->descriptors.create(nv, 128, CV_8U);
  for (int i = 0; i < nq; ++i) {
    query->keypoints.emplace_back(u(random), u(random), 5.f, 0.f);
    fillDescriptor(random, 90, query->descriptors.row(i));
    if (i % 3 == 2) {
      query->keypoints[i].pt = query->keypoints[i - 1].pt + cv::Point2f(0.5f, -0.5f);
      query->descriptors.row(i - 1).copyTo(query->descriptors.row(i));
    }
  }
  for (int j = 0; j < nv; ++j) {
    view->keypoints.emplace_back(u(random), u(random), 5.f, 0.f);
    if (j < common) {
      cv::Mat noise(1, 128, CV_8U);
      fillDescriptor(random, 16, noise);
      cv::add(query->descriptors.row(j), noise, view->descriptors.row(j));
      if (j % 3 == 2) view->keypoints[j].pt = view->keypoints[j - 1].pt + cv::Point2f(0.5f, 3.f);
    } else {
      fillDescriptor(random, 90, view->descriptors.row(j));
    }
  }
}

TEST(DistanceKernel, EveryInstructionSetGivesTheExactDistances) {
  std::mt19937 random(1);
  for (int count : {1, 15, 16, 17, 32, 53}) {
    cv::Mat query(4, 128, CV_8U), rows(count, 128, CV_8U);
    for (int i = 0; i < 4; ++i) fillDescriptor(random, 255, query.row(i));
    for (int j = 0; j < count; ++j) fillDescriptor(random, 255, rows.row(j));
    query.row(0).setTo(255);
    rows.row(0).setTo(255);
    query.row(1).setTo(0);
    const PackedDescriptors packed = packDescriptors(rows.data, count, rows.step[0]);
    for (const Simd simd : {Simd::kNone, Simd::kAvx2, Simd::kAvx512Vnni}) {
      if (!isSupported(simd)) continue;
      std::vector<std::int32_t> out(4 * packed.blocks * kLanes);
      distancesOfFour(query.data, query.step[0], packed, out.data(), simd);
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < count; ++j) {
          const double d = cv::norm(query.row(i), rows.row(j), cv::NORM_L2SQR);
          EXPECT_EQ(out[i * packed.blocks * kLanes + j], static_cast<int>(d)) << static_cast<int>(simd);
          EXPECT_EQ(squaredDistance(query.ptr(i), rows.ptr(j)), static_cast<int>(d));
        }
    }
  }
}

TEST(Pairwise, EqualsTheReferenceOnRandomInput) {
  std::mt19937 random(2);
  for (const auto& [nq, nv] : {std::pair(1, 1), {3, 40}, {4, 7}, {50, 33}, {601, 250}, {333, 999}}) {
    Features query, view;
    makePair(random, nq, nv, std::min(nq, nv) / 2, &query, &view);
    for (const bool mutual : {false, true}) {
      PairwiseSettings settings;
      settings.mutual = mutual;
      settings.max_ratio = 0.97;
      settings.max_distance = 400;
      const auto fast = matchPairwise(query, view, settings), plain = matchPairwiseReference(query, view, settings);
      ASSERT_EQ(fast.size(), plain.size());
      for (std::size_t i = 0; i < fast.size(); ++i) {
        EXPECT_EQ(fast[i].query, plain[i].query);
        EXPECT_EQ(fast[i].view, plain[i].view);
        EXPECT_EQ(fast[i].distance, plain[i].distance);
        EXPECT_EQ(fast[i].ratio, plain[i].ratio);
      }
    }
  }
}

TEST(Pairwise, FindsTheCommonFeaturesOnceEach) {
  std::mt19937 random(4);
  Features query, view;
  makePair(random, 600, 500, 300, &query, &view);
  const auto matches = matchPairwise(query, view);
  std::vector<int> seen(view.size(), 0);
  for (const Match& m : matches) {
    EXPECT_LT(m.view, 300);
    EXPECT_LE(cv::norm(query.keypoints[m.query].pt - query.keypoints[m.view].pt), 1);  // itself or its twin
    EXPECT_EQ(++seen[m.view], 1);
  }
  int places = 0;
  for (int j = 0; j < 300; j += 3) places += seen[j] + std::min(1, seen[j + 1] + seen[j + 2]);
  EXPECT_EQ(places, 200);
}

TEST(Pairwise, ARepeatedWindowIsAmbiguousButTheSamePlaceIsNot) {
  std::mt19937 random(6);
  Features query, view;
  makePair(random, 10, 30, 10, &query, &view);
  // View feature 20 repeats feature 0 at another place; 21 repeats feature 3 at the same place.
  view.descriptors.row(0).copyTo(view.descriptors.row(20));
  view.descriptors.row(3).copyTo(view.descriptors.row(21));
  view.keypoints[20].pt = view.keypoints[0].pt + cv::Point2f(50, 0);
  view.keypoints[21].pt = view.keypoints[3].pt + cv::Point2f(3, 0);
  bool zero = false, three = false;
  for (const Match& m : matchPairwise(query, view)) {
    zero |= m.query == 0;
    three |= m.query == 3;
  }
  EXPECT_FALSE(zero);
  EXPECT_TRUE(three);
}

TEST(Pairwise, NothingFromNothing) {
  std::mt19937 random(7);
  Features query, view, none;
  makePair(random, 10, 10, 10, &query, &view);
  EXPECT_TRUE(matchPairwise(none, view).empty());
  EXPECT_TRUE(matchPairwise(query, none).empty());
  query.descriptors.convertTo(query.descriptors, CV_32F);
  EXPECT_THROW(matchPairwise(query, view), std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
