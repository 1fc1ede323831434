#include "streetview_localizer/virtual_views.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <opencv2/core/persistence.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "streetview_localizer/pairwise.h"

namespace streetview_localizer {
namespace {

air_ground_common::CameraModel distortedCamera() {
  air_ground_common::CameraModel camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = 450;
  camera.fy = 455;
  camera.cx = 330;
  camera.cy = 235;
  camera.k1 = -0.25;
  camera.k2 = 0.06;
  camera.p1 = 0.001;
  return camera;
}

/// Bright blobs of a few sizes: SIFT finds their centres, also where they are foreshortened.
cv::Mat drawDots(const cv::Size& size, int count, unsigned seed, std::vector<cv::Point2f>* centres) {
  cv::Mat image(size, CV_8U, cv::Scalar(70));
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> u(20.f, static_cast<float>(size.width - 20)),
      v(20.f, static_cast<float>(size.height - 20));
  std::uniform_int_distribution<int> grey(140, 255);
  while (static_cast<int>(centres->size()) < count) {
    const cv::Point2f c(u(random), v(random));
    bool free = true;
    for (const cv::Point2f& other : *centres) free &= cv::norm(other - c) > 40;
    if (!free) continue;
    centres->push_back(c);
    cv::circle(image, cv::Point(cvRound(c.x * 16), cvRound(c.y * 16)), 6 * 16, cv::Scalar(grey(random)), -1,
               cv::LINE_AA, 4);
  }
  cv::GaussianBlur(image, image, cv::Size(0, 0), 1.5);
  return image;
}

TEST(VirtualViewWarp, MapsThereAndBack) {
  const auto camera = distortedCamera();
  for (const VirtualView& view : airToGroundViews()) {
    const VirtualViewWarp warp(camera, view);
    for (double y = 40; y < 480; y += 80)
      for (double x = 40; x < 640; x += 80)
        EXPECT_LT((warp.toOriginal(warp.toWarped({x, y})) - Eigen::Vector2d(x, y)).norm(), 1e-6);
  }
}

TEST(VirtualViewWarp, BearsALensModelThatFoldsBeforeTheCorners) {
  auto camera = distortedCamera();
  camera.k1 = -1. / 3;  // rays end 2 / 3 f from the centre: 300 px, the corners are at 400
  camera.k2 = camera.p1 = 0;
  ASSERT_FALSE(camera.unproject({0, 0}).allFinite());
  for (const VirtualView& view : airToGroundViews()) {
    const VirtualViewWarp warp(camera, view);
    EXPECT_GT(warp.size().width, 100);
    EXPECT_LE(warp.size().width, 2 * 480 + 2);
    EXPECT_LE(warp.size().height, 2 * 480 + 2);
    const Eigen::Vector2d middle(320, 240);
    EXPECT_LT((warp.toOriginal(warp.toWarped(middle)) - middle).norm(), 1e-6);
  }
}

TEST(VirtualViewWarp, LooksFromWhereItSays) {
  air_ground_common::CameraModel camera = distortedCamera().undistorted();
  camera.cx = 319.5;
  camera.cy = 239.5;
  const Eigen::Vector2d centre(319.5, 239.5);
  // From below, what is lower is nearer and so larger, and heights are foreshortened by the cosine at the centre.
  const VirtualViewWarp below(camera, {0, -60 * M_PI / 180}, 2);
  const auto area = [&](const VirtualViewWarp& warp, const Eigen::Vector2d& original) {
    return 1 / std::abs(warp.jacobian(warp.toWarped(original)).determinant());
  };
  EXPECT_GT(area(below, centre + Eigen::Vector2d(0, 100)), 1.2 * area(below, centre - Eigen::Vector2d(0, 100)));
  const Eigen::Matrix2d J = below.jacobian(below.toWarped(centre));
  EXPECT_NEAR(J(1, 1), 2 * (camera.fy / (0.5 * (camera.fx + camera.fy))), 0.01);
  EXPECT_NEAR(J(0, 0), 1, 0.02);
  EXPECT_NEAR(J(0, 1), 0, 1e-6);
  // From the right, what is farther right is larger.
  const VirtualViewWarp right(camera, {45 * M_PI / 180, 0}, 2);
  EXPECT_GT(area(right, centre + Eigen::Vector2d(100, 0)), 1.2 * area(right, centre - Eigen::Vector2d(100, 0)));
}

TEST(VirtualViewWarp, RendersThePixelsItMaps) {
  const auto camera = distortedCamera();
  // A smooth image, so that the low-pass changes little: grey = 100 + 50 sin sin.
  cv::Mat image(480, 640, CV_8U);
  const auto value = [](double x, double y) { return 120 + 60 * std::sin(x / 25) * std::sin(y / 30); };
  for (int y = 0; y < 480; ++y)
    for (int x = 0; x < 640; ++x) image.at<unsigned char>(y, x) = cv::saturate_cast<unsigned char>(value(x, y));
  const cv::Mat before = image.clone();
  for (const VirtualView& view : airToGroundViews()) {
    const VirtualViewWarp warp(camera, view);
    for (const bool half : {false, true}) {
      const cv::Mat warped = warp.render(image, half);
      double worst = 0;
      for (int y = 0; y < warped.rows; y += 7)
        for (int x = 0; x < warped.cols; x += 7) {
          const Eigen::Vector2d full = half ? Eigen::Vector2d(2 * x + 0.5, 2 * y + 0.5) : Eigen::Vector2d(x, y);
          const Eigen::Vector2d p = warp.toOriginal(full);
          if (camera.contains(p, 8))
            worst = std::max(worst, std::abs(warped.at<unsigned char>(y, x) - value(p.x(), p.y())));
        }
      EXPECT_LT(worst, 6);
    }
  }
  EXPECT_EQ(cv::norm(image, before, cv::NORM_INF), 0) << "the caller's image was written to";
}

TEST(VirtualViews, KeypointsLandOnTheDotsOfTheOriginal) {
  const auto camera = distortedCamera();
  std::vector<cv::Point2f> centres;
  const cv::Mat image = drawDots({640, 480}, 60, 3, &centres);
  const Features features = extractWithVirtualViews(image, camera);
  std::vector<int> found(airToGroundViews().size() + 1, 0);
  for (const cv::Point2f& c : centres)
    for (std::size_t view = 0; view < found.size(); ++view) {
      double nearest = 1e9;
      for (const cv::KeyPoint& k : features.keypoints)
        if (k.class_id == static_cast<int>(view) && k.size > 8) nearest = std::min(nearest, cv::norm(k.pt - c));
      found[view] += nearest < 0.6;
    }
  // What the merging leaves of the virtual views: what they see differently.
  EXPECT_GT(found[0], 55);
  for (std::size_t view = 1; view < found.size(); ++view) EXPECT_GT(found[view], 10) << "view " << view;
}

TEST(VirtualViews, AreDeterministicAndInsideTheImage) {
  const auto camera = distortedCamera();
  std::vector<cv::Point2f> centres;
  const cv::Mat image = drawDots({640, 480}, 60, 5, &centres);
  const Features a = extractWithVirtualViews(image, camera), b = extractWithVirtualViews(image, camera);
  ASSERT_EQ(a.size(), b.size());
  ASSERT_EQ(a.descriptors.rows, static_cast<int>(a.size()));
  EXPECT_EQ(cv::norm(a.descriptors, b.descriptors, cv::NORM_INF), 0);
  for (const cv::KeyPoint& k : a.keypoints) EXPECT_TRUE(camera.contains({k.pt.x, k.pt.y}));
}

TEST(VirtualViews, RefuseBadInput) {
  auto camera = distortedCamera();
  EXPECT_THROW(extractWithVirtualViews(cv::Mat(100, 100, CV_8U), camera), std::invalid_argument);
  EXPECT_THROW(VirtualViewWarp(camera, {1.5, 0}), std::invalid_argument);
  EXPECT_THROW(VirtualViewWarp(camera, {0, 0}, 0.5), std::invalid_argument);
  camera.fx = 0;
  EXPECT_THROW(VirtualViewWarp(camera, {}), std::invalid_argument);
}

std::filesystem::path sharedFolder() {
  const char* folder = std::getenv("AIR_GROUND_SHARED");
  return folder ? folder : AIR_GROUND_SOURCE_SHARED;
}

/// Correct matches of graffiti 1 and 3 by the given homography.
int countCorrect(const Features& query, const Features& view, const cv::Matx33d& H) {
  int correct = 0;
  for (const Match& m : matchPairwise(query, view)) {
    const cv::Point2f p = query.keypoints[m.query].pt, q = view.keypoints[m.view].pt;
    const cv::Vec3d w = H * cv::Vec3d(p.x, p.y, 1);
    correct += std::hypot(w[0] / w[2] - q.x, w[1] / w[2] - q.y) < 4;
  }
  return correct;
}

TEST(VirtualViews, WidenTheBaselineOfGraffiti) {
  const auto folder = sharedFolder() / "data" / "graf";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder << " is absent";
  const cv::Mat one = cv::imread((folder / "graf1.png").string(), cv::IMREAD_GRAYSCALE);
  const cv::Mat three = cv::imread((folder / "graf3.png").string(), cv::IMREAD_GRAYSCALE);
  cv::FileStorage file((folder / "H1to3p.xml").string(), cv::FileStorage::READ);
  cv::Mat H;
  file["H13"] >> H;
  air_ground_common::CameraModel camera;
  camera.width = one.cols;
  camera.height = one.rows;
  camera.fx = camera.fy = one.cols;
  camera.cx = 0.5 * (one.cols - 1);
  camera.cy = 0.5 * (one.rows - 1);
  const Features view = extractFeatures(three);
  const int plain = countCorrect(extractFeatures(one), view, cv::Matx33d(H));
  const int with_views = countCorrect(extractWithVirtualViews(one, camera), view, cv::Matx33d(H));
  EXPECT_GT(plain, 300);
  EXPECT_GT(with_views, 1.3 * plain);
}

}  // namespace
}  // namespace streetview_localizer
