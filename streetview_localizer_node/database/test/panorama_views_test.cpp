#include "streetview_localizer/panorama_views.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

namespace streetview_localizer {
namespace {

// Smooth on the sphere, and different in every direction: no symmetry hides a flipped or shifted axis.
Eigen::Vector3d pattern(const Eigen::Vector3d& d) {
  return {128 + 100 * std::sin(9 * d.x() + 1) * std::cos(5 * d.z()), 128 + 100 * std::sin(11 * d.y() + 3 * d.x()),
          128 + 60 * d.z() + 50 * std::cos(12 * d.y() - 1)};
}

cv::Mat render(int width) {
  cv::Mat image(width / 2, width, CV_8UC3);
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      const Eigen::Vector3d c = pattern(panoramaRay(image.size(), {double(u), double(v)}));
      image.at<cv::Vec3b>(v, u) = {cv::saturate_cast<uchar>(c.x()), cv::saturate_cast<uchar>(c.y()),
                                   cv::saturate_cast<uchar>(c.z())};
    }
  return image;
}

TEST(PanoramaViews, RaysFollowTheConvention) {
  const cv::Size size(2000, 1000);
  EXPECT_LT((panoramaRay(size, {999.5, 499.5}) - Eigen::Vector3d(1, 0, 0)).norm(), 1e-12);  // the middle: ahead
  EXPECT_LT((panoramaRay(size, {1499.5, 499.5}) - Eigen::Vector3d(0, -1, 0)).norm(),
            1e-12);  // right in the image: right, -y
  EXPECT_LT((panoramaRay(size, {499.5, 499.5}) - Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);
  EXPECT_LT((panoramaRay(size, {-0.5, 499.5}) - Eigen::Vector3d(-1, 0, 0)).norm(), 1e-12);  // the left border: behind
  EXPECT_NEAR(panoramaRay(size, {0, -0.5}).z(), 1, 1e-12);                                  // the top border: zenith
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> u(0, 1);
  for (int i = 0; i < 1000; ++i) {
    const Eigen::Vector2d p(-0.5 + 2000 * u(rng), -0.4 + 999.8 * u(rng));
    EXPECT_LT((panoramaPixel(size, 3.7 * panoramaRay(size, p)) - p).norm(), 1e-6);
  }
}

// Every pixel of every view shows what the sphere shows along its ray: half a pixel of shift would be ten times the
// bound.
TEST(PanoramaViews, PixelsShowWhatLiesAlongTheirRays) {
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  T.linear() = (Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitX()))
                   .toRotationMatrix();
  T.translation() << 5, 6, 7;
  PanoramaViewSettings s;
  s.width = 160;
  s.height = 120;
  s.pitches = {0.0, 0.4};
  for (const int width : {720, 2400}) {  // coarser and finer than the views
    const cv::Mat panorama = render(width);
    const std::vector<View> views = cutPanorama(panorama, T, s);
    ASSERT_EQ(views.size(), 16u);
    for (const View& view : views) {
      EXPECT_LT((view.T_world_camera.translation() - T.translation()).norm(), 1e-12);
      double sum = 0, worst = 0, shifted = 0;
      for (int y = 0; y < s.height; ++y)
        for (int x = 0; x < s.width; ++x) {
          const cv::Vec3b c = view.image.at<cv::Vec3b>(y, x);
          const auto expected = [&](double dx) {
            return pattern(T.linear().transpose() *
                           (view.T_world_camera.linear() * view.camera.ray({x + dx, double(y)})));
          };
          const Eigen::Vector3d seen(c[0], c[1], c[2]);
          sum += (seen - expected(0)).norm();
          shifted += (seen - expected(0.5)).norm();
          worst = std::max(worst, (seen - expected(0)).norm());
        }
      const double n = s.width * s.height;
      EXPECT_LT(sum / n, 0.75);  // rounding to whole grey levels alone gives 0.5 in three channels, twice
      EXPECT_LT(worst, 4);
      EXPECT_GT(shifted / n, 1.5);
    }
  }
  // Optical axes: the first view of a ring looks ahead, the next to the right of it.
  const std::vector<View> views = cutPanorama(render(720), air_ground_common::Pose::Identity(), s);
  EXPECT_LT((views[0].T_world_camera.linear().col(2) - Eigen::Vector3d::UnitX()).norm(), 1e-12);
  EXPECT_LT(views[1].T_world_camera.linear().col(2).y(), -0.7);
  EXPECT_NEAR(views[8].T_world_camera.linear().col(2).z(), std::sin(0.4), 1e-12);
  // Neighbours overlap: half the field of view reaches beyond half the step.
  EXPECT_GT(s.horizontal_fov, 1.5 * s.yaw_step);
}

TEST(PanoramaViews, RefusesWhatIsNoPanorama) {
  EXPECT_THROW(cutPanorama(cv::Mat(), air_ground_common::Pose::Identity()), std::invalid_argument);
  EXPECT_THROW(cutPanorama(cv::Mat(480, 640, CV_8UC3), air_ground_common::Pose::Identity()), std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
