// What other images show of the same piece of facade: which images are asked, and what they say.
#include "streetview_localizer/facade_consistency.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <random>
#include <utility>
#include <vector>

#include "wall_scene.h"

namespace streetview_localizer {
namespace {

TEST(FacadeConsistency, TheWallAgreesAndTheCarDoesNot) {
  const CityModel model = wallModel();
  const BackProjector projector(model);
  std::vector<ConsistencyImage> images(3);
  for (int i = 0; i < 3; ++i) images[i].T_world_image = panoramaPose(10.0 * (i - 1));
  // The assumed poses are wrong as after registration.
  const auto load = [&](int i) {
    air_ground_common::Pose T = images[i].T_world_image;
    T.translation() += Eigen::Vector3d(i == 0 ? 0.15 : -0.1, 0.1, 0.05);
    T.linear() = T.linear() * Eigen::AngleAxisd(i == 2 ? 0.006 : -0.004, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    return wallPanorama(1024, T, i == 1);
  };
  const FacadeConsistency consistency(projector, images, load);
  const Eigen::Vector3d normal(0, -1, 0);
  int good = 0, all = 0, car = 0, cars = 0;
  for (double x = -8; x < 9; x += 0.9)
    for (double z = 2.6; z < 6; z += 0.9, ++all)
      good += consistency.correlation(1, {x, 10, z}, normal) > ConsistencySettings().min_correlation;
  for (double x = 2.2; x < 6.3; x += 0.3, ++cars)
    car += consistency.correlation(1, {x, 10, 0.4}, normal) > ConsistencySettings().min_correlation;
  EXPECT_GT(good, 0.9 * all);
  EXPECT_EQ(car, 0);
  EXPECT_EQ(cars, 14);
}

/// By a look at each of the others.
std::vector<int> neighboursByScan(const std::vector<ConsistencyImage>& images, int own, const ConsistencySettings& s) {
  std::vector<std::pair<double, int>> found;
  for (int i = 0; i < static_cast<int>(images.size()); ++i) {
    const double distance = (images[i].T_world_image.translation() - images[own].T_world_image.translation()).norm();
    if (i != own && images[i].usable && distance > s.min_distance && distance < s.max_distance)
      found.emplace_back(distance, i);
  }
  std::sort(found.begin(), found.end());
  std::vector<int> neighbours;
  for (const auto& [distance, i] : found) neighbours.push_back(i);
  return neighbours;
}

TEST(FacadeConsistency, NeighboursAgreeWithASearchThroughAll) {
  const CityModel model = wallModel();
  const BackProjector projector(model);
  std::mt19937 random(4);
  std::uniform_real_distribution<double> u(-120, 120);
  std::vector<ConsistencyImage> images(600);
  for (ConsistencyImage& image : images) {
    image.T_world_image.translation() << u(random), u(random), 0.1 * u(random);
    image.usable = u(random) > -60;
  }
  // Two at one place, and one where cells of max_distance meet.
  images[1].T_world_image = images[0].T_world_image;
  images[2].T_world_image.translation() << 25, -25, 0;
  const FacadeConsistency consistency(projector, images, [](int) { return cv::Mat(); });
  std::size_t all = 0;
  for (int i = 0; i < 600; ++i) {
    const std::vector<int> expected = neighboursByScan(images, i, {});
    EXPECT_EQ(consistency.neighbours(i), expected) << i;
    all += expected.size();
  }
  EXPECT_GT(all, 3000u);
}

// A look at each of the others would be ten thousand million.
TEST(FacadeConsistency, NeighboursInACityOfAHundredThousandImages) {
  constexpr int kImages = 100000;
  const CityModel model = wallModel();
  const BackProjector projector(model);
  std::vector<ConsistencyImage> images(kImages);
  for (int i = 0; i < kImages; ++i) images[i].T_world_image.translation() << 10.0 * i, 0, 2.5;
  const FacadeConsistency consistency(projector, images, [](int) { return cv::Mat(); });
  for (int i = 2; i < kImages - 2; ++i)
    ASSERT_EQ(consistency.neighbours(i), std::vector<int>({i - 1, i + 1, i - 2, i + 2}));
}

TEST(FacadeConsistency, ImagesAreReadOnce) {
  constexpr int kImages = 30;
  const CityModel model = wallModel();
  const BackProjector projector(model);
  std::vector<ConsistencyImage> images(kImages);
  for (int i = 0; i < kImages; ++i) images[i].T_world_image = panoramaPose(100.0 * i);  // no neighbours
  std::atomic<int> loads{0};
  const FacadeConsistency consistency(projector, images, [&](int) {
    ++loads;
    return cv::Mat(256, 512, CV_8U, cv::Scalar(100));
  });
  for (int round = 0; round < 2; ++round)
    for (int i = 0; i < kImages; ++i) consistency.correlation(i, {0, 10, 3}, {0, -1, 0});
  EXPECT_EQ(loads, kImages);
}

}  // namespace
}  // namespace streetview_localizer
