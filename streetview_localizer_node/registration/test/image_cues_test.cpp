// What is read from a panorama, each against the exact street it was rendered from.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "model_outline.h"
#include "panorama_image.h"
#include "sky.h"
#include "synthetic_street.h"

namespace streetview_localizer::registration {
namespace {

using air_ground_common::Pose;

TEST(PanoramaImage, RayAndPixelAreInverse) {
  // Column 0 looks backwards, azimuth falls to the right, the top row looks up.
  EXPECT_LT((rayOf(511.5, 255.5, 1024, 512) - Eigen::Vector3d::UnitX()).norm(), 1e-12);
  EXPECT_LT((rayOf(255.5, 255.5, 1024, 512) - Eigen::Vector3d::UnitY()).norm(), 1e-12);
  EXPECT_GT(rayOf(0, 0, 1024, 512).z(), 0.99);
  std::mt19937_64 random(1);
  for (int i = 0; i < 200; ++i) {
    const double u = std::uniform_real_distribution<double>(0, 1023)(random),
                 v = std::uniform_real_distribution<double>(1, 510)(random);
    EXPECT_LT((pixelOf(3.0 * rayOf(u, v, 1024, 512), 1024, 512) - Eigen::Vector2d(u, v)).norm(), 1e-9);
  }
}

TEST(PanoramaImage, TurningMovesAPointWhereItShould) {
  cv::Mat image(256, 512, CV_8UC3, cv::Scalar::all(0));
  cv::circle(image, {200, 100}, 3, {255, 255, 255}, -1);
  const Eigen::Matrix3d R = air_ground_common::expSO3({0.1, -0.2, 0.4});
  const cv::Mat turned = turnPanorama(image, R, cv::INTER_LINEAR);
  cv::Mat gray;
  cv::cvtColor(turned, gray, cv::COLOR_BGR2GRAY);
  const cv::Moments moments = cv::moments(gray);
  const Eigen::Vector2d expected = pixelOf(R.transpose() * rayOf(200, 100, 512, 256), 512, 256);
  EXPECT_NEAR(moments.m10 / moments.m00, expected.x(), 0.3);
  EXPECT_NEAR(moments.m01 / moments.m00, expected.y(), 0.3);
}

TEST(PanoramaImage, VerticalLinesTellWhatIsUp) {
  std::vector<double> errors;
  for (int seed = 101; seed <= 102; ++seed) {
    SyntheticStreetSettings settings;
    settings.seed = seed;
    const SyntheticStreet street(settings);
    std::mt19937_64 random(seed);
    const Pose pose = street.panoramaPose(50, &random);
    double stddev = 0;
    const Eigen::Vector3d up = verticalDirection(findSegments(street.render(pose), {}, 1.1), 0.03, &stddev);
    const Eigen::Vector3d truth = pose.linear().transpose() * Eigen::Vector3d::UnitZ();
    errors.push_back(std::acos(std::min(1.0, up.dot(truth))));
    EXPECT_LT(errors.back(), 0.005) << "seed " << seed;
    EXPECT_LT(errors.back(), 5 * stddev);
    EXPECT_LT(stddev, 0.004);
  }
}

TEST(PanoramaImage, AnImageWithoutLinesKeepsTheStart) {
  double stddev = 0;
  const cv::Mat blank(256, 512, CV_8UC3, cv::Scalar(120, 130, 140));
  EXPECT_EQ(verticalDirection(findSegments(blank, {}, 1.1), 0.03, &stddev), Eigen::Vector3d::UnitZ());
  EXPECT_DOUBLE_EQ(stddev, 0.03);
}

TEST(PanoramaImage, VerticalEvidenceKnowsTheColumn) {
  // Another colour from column 300 on: the boundary lies between 299 and 300. Half as strong where half the rows
  // change.
  cv::Mat image(512, 1024, CV_8UC3, cv::Scalar(60, 80, 100));
  image.colRange(300, 600).setTo(cv::Scalar(120, 130, 90));
  const VerticalEvidence evidence(image, {});
  EXPECT_EQ(evidence.strength(299, 100, 300), evidence.strength(301, 100, 300));
  EXPECT_EQ(evidence.strength(297, 100, 300), 0);
  EXPECT_EQ(evidence.strength(303, 100, 300), 0);
  EXPECT_NEAR(evidence.strength(300, 100, 300), 1, 1e-3);
  image(cv::Rect(300, 200, 300, 312)).setTo(cv::Scalar(60, 80, 100));
  EXPECT_NEAR(VerticalEvidence(image, {}).strength(300, 100, 300), 0.5, 0.02);
}

TEST(SkyLine, FollowsTheRoofs) {
  for (int seed = 111; seed <= 112; ++seed) {
    SyntheticStreetSettings settings;
    settings.seed = seed;
    settings.model_height_stddev = settings.model_lateral_stddev = 0;  // the model is the truth
    const SyntheticStreet street(settings);
    const ModelOutline model(street.model());
    const Pose pose = air_ground_common::yawPose(0.3, {40 * std::cos(0.4), 40 * std::sin(0.4), 2.5 + 0.03 * 40});
    const SkyLine sky = findSkyLine(street.render(pose), {});
    ASSERT_EQ(sky.failure, "");
    std::vector<double> errors;
    SkyProfile profile;
    ModelOutline::skyProfile(model.edgesNear(pose.translation(), 300), pose.translation(), 1024, &profile);
    for (int i = 0; i < 1024; ++i) {
      const Eigen::Vector3d world = pose.linear() * rayOf(i, 255.5, 1024, 512);
      const int bin = static_cast<int>(std::lround(pixelOf(world, 1024, 512).x() + 1024)) % 1024;
      if (profile.tangent[bin] < 0.1f) continue;  // the ground's edge
      errors.push_back(std::abs((0.5 - std::atan(profile.tangent[bin]) / M_PI) * 512 - 0.5 - sky.row[i]));
    }
    std::sort(errors.begin(), errors.end());
    EXPECT_LT(errors[errors.size() / 2], 0.5) << "seed " << seed;
    EXPECT_LT(errors[errors.size() * 9 / 10], 3.0) << "seed " << seed;
  }
}

TEST(SkyLine, ThereIsNoneInABlankOrIndoorImage) {
  const cv::Mat black(256, 512, CV_8UC3, cv::Scalar::all(0));
  const SkyLine line = findSkyLine(black, {});
  if (line.failure.empty()) {
    // All of it may pass for sky; then it has no outline above the horizon.
    EXPECT_GT(*std::min_element(line.row.begin(), line.row.end()), 120);
  }
}

TEST(SkyLine, RealPanorama) {
  const char* shared = std::getenv("AIR_GROUND_SHARED");
  const std::string folder = shared ? shared : std::string(AIR_GROUND_SOURCE_DIR) + "/../shared";
  const cv::Mat image = cv::imread(folder + "/data/pano/streetview_2048.jpg");
  if (image.empty()) GTEST_SKIP() << "no " << folder << "/data/pano/streetview_2048.jpg";
  const SkyLine line = findSkyLine(image, {});
  ASSERT_EQ(line.failure, "");
  // Read off by eye: sky line rows at some columns, away from lamp posts.
  const int checks[][2] = {{120, 490}, {340, 450}, {520, 395}, {620, 335}, {780, 402}, {1640, 420}, {1900, 472}};
  int right = 0;
  for (const auto& check : checks) {
    if (std::abs(line.row[check[0]] - check[1]) < 20) ++right;
  }
  EXPECT_GE(right, 6);
}

TEST(ModelOutline, SkyProfileIsThatOfRays) {
  SyntheticStreetSettings settings;
  settings.seed = 121;
  const SyntheticStreet street(settings);
  const ModelOutline model(street.model());
  const Eigen::Vector3d position(40 * std::cos(0.4), 40 * std::sin(0.4), 3.7);
  SkyProfile profile;
  ModelOutline::skyProfile(model.edgesNear(position, 300), position, 360, &profile);
  for (int i = 0; i < 360; ++i) {
    const double azimuth = (0.5 - (i + 0.5) / 360) * 2 * M_PI;
    auto hits = [&](double tangent) {
      const Eigen::Vector3f d(std::cos(azimuth), std::sin(azimuth), tangent);
      const auto hit = model.scene().cast(position.cast<float>(), d.normalized());
      return hit && model.solid(hit->triangle);
    };
    if (profile.building[i] < 0) continue;
    EXPECT_TRUE(hits(profile.tangent[i] - 0.01)) << i;
    EXPECT_FALSE(hits(profile.tangent[i] + 0.01)) << i;
  }
  EXPECT_FALSE(model.insideBuilding(position));
  EXPECT_TRUE(model.insideBuilding(position + 11 * Eigen::Vector3d(-std::sin(0.4), std::cos(0.4), 0)) ||
              model.insideBuilding(position + 11 * Eigen::Vector3d(-std::sin(0.4), std::cos(0.4), 0) +
                                   Eigen::Vector3d(4, 2, 0)));
  EXPECT_NEAR(model.groundHeight(position.x(), position.y()).value(), 40 * 0.03, 1e-3);
}

// A town at 5400 m, in a frame that counts from sea level.
TEST(ModelOutline, GroundIsFoundAtAnyHeight) {
  for (const float height : {-6000.f, 0.f, 5400.f}) {
    CityModel model;
    model.building_ids = {"wall"};
    const auto triangle = [&](const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c,
                              Surface surface, int building) {
      const int first = static_cast<int>(model.mesh.vertices.size());
      for (const Eigen::Vector3f& p : {a, b, c}) model.mesh.vertices.push_back(p + Eigen::Vector3f(0, 0, height));
      model.mesh.triangles.emplace_back(first, first + 1, first + 2);
      model.surface.push_back(surface);
      model.building.push_back(building);
    };
    triangle({-50, -50, 0}, {50, -50, 0}, {0, 50, 5}, Surface::kGround, -1);
    triangle({0, 0, 0}, {8, 0, 0}, {8, 0, 6}, Surface::kWall, 0);
    const ModelOutline outline(model);
    const auto ground = outline.groundHeight(0, 0);
    ASSERT_TRUE(ground) << height;
    EXPECT_NEAR(*ground, height + 2.5, 2e-3);
    EXPECT_FALSE(outline.groundHeight(200, 0));
  }
}

// A box on stilts: its underside closes it, so that who stands below is outside.
TEST(ModelOutline, BelowAnUndersideIsOutside) {
  CityModel model;
  model.building_ids = {"oriel"};
  for (const float z : {3.f, 9.f})
    for (const auto& [x, y] : {std::make_pair(0.f, 0.f), {8.f, 0.f}, {8.f, 6.f}, {0.f, 6.f}})
      model.mesh.vertices.emplace_back(x, y, z);
  const auto face = [&](int a, int b, int c, int d, Surface surface) {
    for (const Eigen::Vector3i& t : {Eigen::Vector3i(a, b, c), Eigen::Vector3i(a, c, d)}) {
      model.mesh.triangles.push_back(t);
      model.surface.push_back(surface);
      model.building.push_back(0);
    }
  };
  face(0, 3, 2, 1, Surface::kGround);
  face(4, 5, 6, 7, Surface::kRoof);
  for (int i = 0; i < 4; ++i) face(i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i, Surface::kWall);
  const ModelOutline outline(model);
  EXPECT_FALSE(outline.insideBuilding({4, 2, 1.7}));
  EXPECT_TRUE(outline.insideBuilding({4, 2, 5}));
  EXPECT_FALSE(outline.insideBuilding({4, 2, 12}));
  EXPECT_FALSE(outline.insideBuilding({-2, 2, 5}));
}

}  // namespace
}  // namespace streetview_localizer::registration
