#include "streetview_localizer/kvld.h"

#include <gtest/gtest.h>

#include <omp.h>

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

namespace streetview_localizer {
namespace {

/// A facade of many rectangles and lines.
cv::Mat drawFacade(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> x(-20, 640), y(-20, 480), side(8, 70), grey(0, 255);
  cv::Mat image(480, 640, CV_8U, cv::Scalar(128));
  for (int i = 0; i < 250; ++i) {
    const cv::Rect box(x(random), y(random), side(random), side(random));
    cv::rectangle(image, box, cv::Scalar(grey(random)), i % 3 ? -1 : 2);
    if (i % 5 == 0) cv::line(image, box.br(), {x(random), y(random)}, cv::Scalar(grey(random)), 2, cv::LINE_AA);
  }
  return image;
}

struct Scene {
  cv::Mat query, view;
  std::vector<cv::KeyPoint> query_keypoints, view_keypoints;
  std::vector<Match> matches;
  int inliers = 0;  ///< the first so many matches are right
};

/// The query, and what another camera sees of it (H), with right matches disturbed by keypoint noise and wrong ones.
Scene makeScene(unsigned seed, int inliers, int outliers, double pixel_noise, double angle_noise_deg, double size_noise,
                const cv::Matx33d& H, bool mirrored = false) {
  Scene s;
  s.query = drawFacade(seed);
  cv::warpPerspective(s.query, s.view, H, s.query.size(), cv::INTER_LINEAR, cv::BORDER_CONSTANT, 128);
  std::mt19937 random(seed + 1000);
  std::uniform_real_distribution<float> x(10, 630), y(10, 470), angle(0, 360);
  std::normal_distribution<double> normal;
  const auto map = [&](cv::Point2f p) {
    const cv::Vec3d w = H * cv::Vec3d(p.x, p.y, 1);
    return cv::Point2f(static_cast<float>(w[0] / w[2]), static_cast<float>(w[1] / w[2]));
  };
  const cv::Rect2f frame(5, 5, 630, 470);
  while (static_cast<int>(s.matches.size()) < inliers + outliers) {
    const cv::KeyPoint q(x(random), y(random), 6.f, angle(random));
    cv::KeyPoint v;
    if (static_cast<int>(s.matches.size()) < inliers) {
      const float a = q.angle * static_cast<float>(M_PI / 180);
      const cv::Point2f centre = map(q.pt), ahead = map(q.pt + cv::Point2f(std::cos(a), std::sin(a))) - centre;
      const cv::Point2f right = map(q.pt + cv::Point2f(1, 0)) - centre, down = map(q.pt + cv::Point2f(0, 1)) - centre;
      const double scale = std::sqrt(std::abs(right.cross(down)));
      v = cv::KeyPoint(
          centre + cv::Point2f(static_cast<float>(pixel_noise * normal(random)),
                               static_cast<float>(pixel_noise * normal(random))),
          static_cast<float>(6 * scale * std::exp(size_noise * normal(random))),
          static_cast<float>(std::atan2(ahead.y, ahead.x) * 180 / M_PI + angle_noise_deg * normal(random)));
      if (!frame.contains(v.pt)) continue;
    } else {
      v = cv::KeyPoint(x(random), y(random), 6.f * std::exp(0.3f * static_cast<float>(normal(random))), angle(random));
    }
    Match m;
    m.query = m.view = static_cast<int>(s.matches.size());
    s.query_keypoints.push_back(q);
    s.view_keypoints.push_back(v);
    s.matches.push_back(m);
  }
  s.inliers = inliers;
  if (mirrored) {
    cv::flip(s.view, s.view, 1);
    for (cv::KeyPoint& k : s.view_keypoints) {
      k.pt.x = static_cast<float>(s.view.cols - 1) - k.pt.x;
      k.angle = 180 - k.angle;
    }
  }
  return s;
}

KvldResult filter(const Scene& s, const KvldSettings& settings = {}) {
  return filterKvld(GradientPyramid(s.query), GradientPyramid(s.view), s.query_keypoints, s.view_keypoints, s.matches,
                    settings);
}

int countInliers(const Scene& s, const KvldResult& result) {
  int count = 0;
  for (int k : result.kept) count += k < s.inliers;
  return count;
}

const cv::Matx33d kFromTheSide(0.75, -0.12, 70, 0.10, 0.95, -10, 2e-4, -1e-4, 1);

TEST(LineDescriptor, DoesNotChangeWithRotationAndScale) {
  const cv::Mat image = drawFacade(1);
  const double a = 0.6, scale = 0.7;
  const cv::Matx33d H(scale * std::cos(a), -scale * std::sin(a), 220, scale * std::sin(a), scale * std::cos(a), -20, 0,
                      0, 1);
  cv::Mat turned;
  cv::warpPerspective(image, turned, H, image.size(), cv::INTER_AREA);
  const GradientPyramid one(image), two(turned);
  const auto map = [&](cv::Point2f p) {
    return cv::Point2f(static_cast<float>(H(0, 0) * p.x + H(0, 1) * p.y + H(0, 2)),
                       static_cast<float>(H(1, 0) * p.x + H(1, 1) * p.y + H(1, 2)));
  };
  std::mt19937 random(1);
  std::uniform_real_distribution<float> x(200, 440), y(140, 340), step(-90, 90);
  double same = 0, different = 0;
  for (int i = 0; i < 100; ++i) {
    const cv::Point2f p(x(random), y(random)), q = p + cv::Point2f(step(random), step(random)), r(x(random), y(random));
    const LineDescriptor line = describeLine(one, p, q);
    same += lineDistance(line, describeLine(two, map(p), map(q))) / 100;
    different += lineDistance(line, describeLine(two, map(p), map(r))) / 100;
  }
  EXPECT_LT(same, 0.15);
  EXPECT_GT(different, 0.35);
}

TEST(LineDescriptor, ABlankWallSaysNothing) {
  const GradientPyramid blank(cv::Mat(200, 200, CV_8U, cv::Scalar(90)));
  const LineDescriptor line = describeLine(blank, {50, 50}, {150, 120});
  EXPECT_FALSE(line.valid);
  EXPECT_EQ(lineDistance(line, line), 1);
  EXPECT_FALSE(describeLine(blank, {50, 50}, {50, 50}).valid);
}

TEST(LineDescriptor, DistanceIsZeroToItselfAndSymmetric) {
  const GradientPyramid image(drawFacade(2));
  const LineDescriptor a = describeLine(image, {100, 100}, {180, 150}), b = describeLine(image, {300, 200}, {320, 290});
  EXPECT_EQ(lineDistance(a, a), 0);
  EXPECT_EQ(lineDistance(a, b), lineDistance(b, a));
}

TEST(GeometricInconsistency, IsZeroForASimilarityAndLargeForOthers) {
  const auto keypoint = [](float x, float y, float size, float angle) { return cv::KeyPoint(x, y, size, angle); };
  const float c = 2 * std::cos(0.5f), s = 2 * std::sin(0.5f), turn = 0.5f * 180 / static_cast<float>(M_PI);
  const auto map = [&](const cv::KeyPoint& k) {
    return keypoint(c * k.pt.x - s * k.pt.y + 7, s * k.pt.x + c * k.pt.y - 3, 2 * k.size, k.angle + turn);
  };
  const cv::KeyPoint a = keypoint(10, 20, 5, 30), b = keypoint(60, 5, 8, 100);
  EXPECT_NEAR(geometricInconsistency(a, map(a), b, map(b)), 0, 1e-5);
  cv::KeyPoint turned = map(b);
  turned.angle += 180;
  EXPECT_NEAR(geometricInconsistency(a, map(a), b, turned), 1, 1e-5);  // b's two predictions are twice as wrong as long
}

TEST(Kvld, KeepsInliersAndRemovesOutliersOverNoiseAndOutlierShare) {
  for (const double noise : {0.5, 1.5})
    for (const int outliers : {60, 200, 600}) {
      double kept = 0, wrong = 0;
      for (unsigned seed : {11u, 12u}) {
        const Scene s = makeScene(seed, 200, outliers, noise, 5 * noise, 0.1 * noise, kFromTheSide);
        const KvldResult result = filter(s);
        const int right = countInliers(s, result);
        kept += right / 400.0;
        wrong += (static_cast<double>(result.kept.size()) - right) / (2.0 * outliers);
        for (int supporters : result.supporters) EXPECT_GE(supporters, 3);
      }
      RecordProperty("kept_" + std::to_string(outliers), std::to_string(kept));
      EXPECT_GT(kept, outliers < 600 ? 0.9 : 0.75) << "noise " << noise << ", outliers " << outliers;
      EXPECT_LT(wrong, 0.01) << "noise " << noise << ", outliers " << outliers;
    }
}

TEST(Kvld, KeepsNothingOfOutliersOnly) {
  const Scene s = makeScene(21, 0, 500, 0, 0, 0, kFromTheSide);
  EXPECT_TRUE(filter(s).kept.empty());
}

TEST(Kvld, KeepsNothingOfAMirroredView) {
  const Scene s = makeScene(22, 300, 50, 0.5, 2, 0.05, kFromTheSide, true);
  EXPECT_TRUE(filter(s).kept.empty());
}

/// Equal windows, and every match to the window that stands mirrored in the row: each window alone is perfectly
/// consistent.
TEST(Kvld, KeepsNothingWhenTheOrderOfEqualWindowsIsReversed) {
  cv::Mat window = drawFacade(5)(cv::Rect(100, 100, 80, 80)).clone(), image(480, 640, CV_8U, cv::Scalar(128));
  std::vector<cv::KeyPoint> query, view, reversed;
  std::vector<Match> matches;
  std::mt19937 random(8);
  std::uniform_real_distribution<float> inside(4, 76);
  for (int row = 0; row < 4; ++row)
    for (int column = 0; column < 6; ++column) {
      const cv::Point2f corner(20 + 100.f * static_cast<float>(column), 20 + 110.f * static_cast<float>(row));
      window.copyTo(image(cv::Rect(cvRound(corner.x), cvRound(corner.y), 80, 80)));
      for (int k = 0; k < 12; ++k) {
        const cv::Point2f p = corner + cv::Point2f(inside(random), inside(random));
        query.emplace_back(p, 6.f, 0.f);
        view.emplace_back(p, 6.f, 0.f);
        reversed.emplace_back(p + cv::Point2f(100.f * static_cast<float>(5 - 2 * column), 0), 6.f, 0.f);
        Match m;
        m.query = m.view = static_cast<int>(matches.size());
        matches.push_back(m);
      }
    }
  const GradientPyramid pyramid(image);
  EXPECT_GT(filterKvld(pyramid, pyramid, query, view, matches).kept.size(), 270u);
  KvldSettings as_in_the_paper;
  as_in_the_paper.min_order_agreement = 0;
  EXPECT_GT(filterKvld(pyramid, pyramid, query, reversed, matches, as_in_the_paper).kept.size(), 250u);
  EXPECT_TRUE(filterKvld(pyramid, pyramid, query, reversed, matches).kept.empty());
}

TEST(Kvld, OfCompetingMatchesTheBestSupportedStays) {
  Scene s = makeScene(31, 200, 0, 0.5, 2, 0.05, kFromTheSide);
  // Every query keypoint also matches the view keypoint of another.
  for (int i = 0; i < 200; ++i) {
    Match m;
    m.query = i;
    m.view = (i + 17) % 200;
    s.matches.push_back(m);
  }
  const KvldResult result = filter(s);
  EXPECT_GT(countInliers(s, result), 180);
  EXPECT_EQ(countInliers(s, result), static_cast<int>(result.kept.size()));
}

TEST(Kvld, DoesNotDependOnTheNumberOfThreads) {
  const Scene s = makeScene(41, 200, 300, 1, 5, 0.1, kFromTheSide);
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const KvldResult one = filter(s);
  omp_set_num_threads(5);
  const KvldResult five = filter(s);
  omp_set_num_threads(threads);
  EXPECT_EQ(one.kept, five.kept);
  EXPECT_EQ(one.supporters, five.supporters);
}

TEST(Kvld, RefusesMatchesWithoutKeypoints) {
  Scene s = makeScene(51, 10, 0, 0, 0, 0, kFromTheSide);
  s.matches[3].view = 10;
  EXPECT_THROW(filter(s), std::invalid_argument);
  s.matches.clear();
  EXPECT_TRUE(filter(s).kept.empty());
}

}  // namespace
}  // namespace streetview_localizer
