#include "air_ground_common/camera_model.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <opencv2/calib3d.hpp>
#include <random>
#include <stdexcept>

#include "air_ground_common/camera_file.h"

namespace air_ground_common {
namespace {

CameraModel wideAngle() {
  CameraModel c;
  c.width = 752;
  c.height = 480;
  c.fx = 410;
  c.fy = 412;
  c.cx = 370.5;
  c.cy = 236.25;
  c.k1 = -0.28;
  c.k2 = 0.07;
  c.p1 = 2e-4;
  c.p2 = -3e-4;
  return c;
}

TEST(CameraModel, ProjectionMatchesOpenCv) {
  const CameraModel camera = wideAngle();
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(-0.7, 0.7);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector3d p(u(rng) * 2, u(rng) * 2, 2.0);
    std::vector<cv::Point2d> pixel;
    cv::projectPoints(std::vector<cv::Point3d>{{p.x(), p.y(), p.z()}}, cv::Vec3d(), cv::Vec3d(), camera.cvK(),
                      camera.cvDistortion(), pixel);
    const auto ours = camera.project(p);
    ASSERT_TRUE(ours);
    EXPECT_NEAR(ours->x(), pixel[0].x, 1e-9);
    EXPECT_NEAR(ours->y(), pixel[0].y, 1e-9);
  }
}

TEST(CameraModel, UnprojectInvertsProjectOverTheWholeImage) {
  const CameraModel camera = wideAngle();
  for (int y = 0; y < camera.height; y += 40)
    for (int x = 0; x < camera.width; x += 40) {
      const auto pixel = camera.project(3.0 * camera.ray({x, y}));
      ASSERT_TRUE(pixel);
      EXPECT_LT((*pixel - Eigen::Vector2d(x, y)).norm(), 1e-6) << x << ' ' << y;
    }
}

TEST(CameraModel, JacobianMatchesFiniteDifferences) {
  const CameraModel camera = wideAngle();
  const Eigen::Vector3d p(0.4, -0.3, 1.7);
  Eigen::Matrix<double, 2, 3> J;
  const auto pixel = camera.project(p, &J);
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector2d numeric = (*camera.project(p + 1e-6 * Eigen::Vector3d::Unit(k)) - *pixel) / 1e-6;
    EXPECT_LT((numeric - J.col(k)).norm(), 1e-2);
  }
}

TEST(CameraModel, RefusesWhatItCannotUse) {
  EXPECT_FALSE(wideAngle().project({0, 0, -1}));
  EXPECT_FALSE(wideAngle().project({0, 0, 0}));
  CameraModel bad = wideAngle();
  bad.fx = 0;
  try {
    bad.validate();
    FAIL() << "fx = 0 was accepted";
  } catch (const std::invalid_argument& e) {
    EXPECT_NE(std::string(e.what()).find("fx"), std::string::npos);
  }
  // The determinant of their matrix would be none.
  bad = wideAngle();
  bad.fx = bad.fy = 1e200;
  EXPECT_THROW(bad.validate(), std::invalid_argument);
  bad.fx = bad.fy = 1e-200;
  EXPECT_THROW(bad.validate(), std::invalid_argument);
  bad = wideAngle();
  bad.cy = -1e300;
  EXPECT_THROW(bad.validate(), std::invalid_argument);
}

// Azure Kinect's colour camera (rational), one with thin prism, and a fisheye of 150 degrees across.
std::vector<CameraModel> wideCameras() {
  CameraModel rational;
  rational.width = 1280;
  rational.height = 720;
  rational.fx = 608.4;
  rational.fy = 608.2;
  rational.cx = 638.7;
  rational.cy = 366.6;
  rational.setDistortion("rational_polynomial", {0.5222, -2.6634, 7.6e-4, -2.3e-4, 1.5373, 0.4033, -2.4916, 1.4659});
  CameraModel prism = rational;
  prism.setDistortion("rational_polynomial", {0.3, 0.02, 7e-4, -2e-4, 0.01, 0.62, 0.1, 0.015, 1e-3, -2e-4, 5e-4, 1e-4});
  CameraModel fisheye;
  fisheye.width = 752;
  fisheye.height = 480;
  fisheye.fx = 286.9;
  fisheye.fy = 287.2;
  fisheye.cx = 373.1;
  fisheye.cy = 241.4;
  fisheye.setDistortion("equidistant", {-0.0121, 0.0234, -0.0194, 0.0051});
  return {rational, prism, fisheye};
}

// Random points in view of the camera, up to `half_angle` off its axis.
std::vector<Eigen::Vector3d> pointsWithin(double half_angle, int count) {
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> u(0, 1);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < count; ++i) {
    const double theta = half_angle * u(rng), phi = 2 * M_PI * u(rng), distance = 0.3 + 20 * u(rng);
    points.push_back(
        distance * Eigen::Vector3d(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)));
  }
  return points;
}

TEST(CameraModel, WideModelsMatchOpenCv) {
  for (const CameraModel& camera : wideCameras()) {
    const bool fisheye = camera.model == DistortionModel::kEquidistant;
    for (const Eigen::Vector3d& p : pointsWithin(fisheye ? 1.35 : 0.85, 500)) {
      const std::vector<cv::Point3d> object{{p.x(), p.y(), p.z()}};
      std::vector<cv::Point2d> pixel;
      if (fisheye)
        cv::fisheye::projectPoints(object, pixel, cv::Vec3d(), cv::Vec3d(), camera.cvK(), camera.cvDistortion());
      else
        cv::projectPoints(object, cv::Vec3d(), cv::Vec3d(), camera.cvK(), camera.cvDistortion(), pixel);
      const auto ours = camera.project(p);
      ASSERT_TRUE(ours) << camera.distortionName();
      EXPECT_NEAR(ours->x(), pixel[0].x, 1e-7) << camera.distortionName();
      EXPECT_NEAR(ours->y(), pixel[0].y, 1e-7) << camera.distortionName();
    }
  }
}

TEST(CameraModel, WideModelsInvertOverTheWholeImage) {
  for (const CameraModel& camera : wideCameras()) {
    int seen = 0, pixels = 0;
    for (int y = 0; y < camera.height; y += 8)
      for (int x = 0; x < camera.width; x += 8) {
        ++pixels;
        const Eigen::Vector3d ray = camera.ray({x, y});
        if (!ray.allFinite()) continue;
        const auto pixel = camera.project(2.5 * ray);
        // On the very rim of the cone, rounding may fall to either side.
        if (!pixel && ray.z() < std::cos(CameraModel::kMaxHalfAngle) + 1e-9) continue;
        ASSERT_TRUE(pixel) << x << ' ' << y;
        EXPECT_LT((*pixel - Eigen::Vector2d(x, y)).norm(), 1e-6) << camera.distortionName() << ' ' << x << ' ' << y;
        ++seen;
      }
    // The fisheye's corners lie beyond 80 degrees off the axis.
    EXPECT_GT(seen, (camera.model == DistortionModel::kEquidistant ? 0.97 : 1.0) * pixels - 1);
  }
}

TEST(CameraModel, WideModelsHaveExactJacobians) {
  for (const CameraModel& camera : wideCameras()) {
    for (const Eigen::Vector3d& p : pointsWithin(camera.model == DistortionModel::kEquidistant ? 1.35 : 0.8, 50)) {
      Eigen::Matrix<double, 2, 3> J;
      ASSERT_TRUE(camera.project(p, &J));
      const double h = 1e-6 * p.norm();
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector3d d = h * Eigen::Vector3d::Unit(k);
        const Eigen::Vector2d numeric = (*camera.project(p + d) - *camera.project(p - d)) / (2 * h);
        EXPECT_LT((numeric - J.col(k)).norm(), 1e-5 * (1 + J.norm())) << camera.distortionName();
      }
    }
  }
}

TEST(CameraModel, NothingIsSeenBeyondTheUsableCone) {
  const CameraModel fisheye = wideCameras()[2];
  const auto at = [](double degrees) {
    const double a = degrees * M_PI / 180;
    return Eigen::Vector3d(std::sin(a), 0, std::cos(a));
  };
  EXPECT_TRUE(fisheye.project(at(75)));
  EXPECT_TRUE(fisheye.project(at(79.9)));
  EXPECT_FALSE(fisheye.project(at(80.1)));
  EXPECT_FALSE(fisheye.project(at(95)));
  EXPECT_FALSE(fisheye.unproject({fisheye.cx + 600, fisheye.cy}).allFinite());
  // r (1 - r^2 / 3) grows up to r = 1 only: what lies beyond would be folded back into the image.
  CameraModel folding = wideCameras()[0];
  folding.setDistortion("plumb_bob", {-1. / 3});
  EXPECT_NEAR(folding.max_radius, 1, 0.01);
  EXPECT_TRUE(folding.project({0.98, 0, 1}));
  EXPECT_FALSE(folding.project({1.3, 0, 1}));
}

// 92 degrees across by its focal length. The radius stops growing at 0.976, where that of the corners is 1.18.
CameraModel foldingCamera(double p1, double p2) {
  CameraModel c;
  c.width = 1280;
  c.height = 720;
  c.fx = c.fy = 620;
  c.cx = 639.5;
  c.cy = 359.5;
  c.setDistortion("plumb_bob", {-0.31, 0.105, p1, p2, -0.017});
  return c;
}

TEST(CameraModel, NothingIsSeenWherePlumbBobFoldsInsideTheImage) {
  const CameraModel camera = foldingCamera(0, 0);
  const auto radiusOf = [&](const Eigen::Vector2d& pixel) {
    return (pixel - Eigen::Vector2d(camera.cx, camera.cy)).norm() / camera.fx;
  };
  EXPECT_FALSE(camera.unproject({0, 0}).allFinite());
  EXPECT_FALSE(camera.contains({0, 0}));
  for (int y = 0; y < camera.height; y += 4)
    for (int x = 0; x < camera.width; x += 4) {
      const Eigen::Vector2d pixel(x, y), n = camera.unproject(pixel);
      if (std::abs(radiusOf(pixel) - 0.976) < 1e-3) continue;  // the rim itself
      ASSERT_EQ(n.allFinite(), radiusOf(pixel) < 0.976) << x << ' ' << y << ": " << n.transpose();
      ASSERT_EQ(camera.contains(pixel), radiusOf(pixel) < 0.976) << x << ' ' << y;
      if (!n.allFinite()) continue;
      const auto seen = camera.project(n.homogeneous());
      ASSERT_TRUE(seen) << x << ' ' << y;
      EXPECT_LT((*seen - pixel).norm(), 1e-6) << x << ' ' << y;
      EXPECT_GT(n.dot(pixel - Eigen::Vector2d(camera.cx, camera.cy)), 0) << x << ' ' << y << " is mirrored";
    }
  EXPECT_TRUE(camera.contains({camera.cx, 1}, 1));
  EXPECT_TRUE(camera.contains({camera.cx + 595, camera.cy}, 10));
  EXPECT_FALSE(camera.contains({camera.cx + 600, camera.cy}, 10)) << "10 px from the rim";
}

TEST(CameraModel, WhatItContainsHasARay) {
  std::vector<CameraModel> cameras = wideCameras();
  for (const double p : {-8e-3, 8e-3}) cameras.push_back(foldingCamera(p, -0.7 * p));
  for (const CameraModel& camera : cameras) {
    int seen = 0;
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x) {
        if (!camera.contains({x, y})) continue;
        const auto pixel = camera.project(camera.unproject({x, y}).homogeneous());
        ASSERT_TRUE(pixel) << camera.distortionName() << ' ' << x << ' ' << y;
        ASSERT_LT((*pixel - Eigen::Vector2d(x, y)).norm(), 1e-6) << camera.distortionName() << ' ' << x << ' ' << y;
        ++seen;
      }
    EXPECT_GT(seen, 0.8 * camera.width * camera.height);
  }
}

TEST(CameraModel, NoiseOnTheNormalizedPlaneFollowsThePixels) {
  // Half a pixel towards the rim and across, at 70 degrees: tan grows by 1/cos^2 a radian, the circle by tan.
  CameraModel camera = wideCameras()[2];
  camera.fy = camera.fx;
  camera.setDistortion("equidistant", {});
  const double theta = 70 * M_PI / 180;
  const Eigen::Vector2d n(0, std::tan(theta));
  const NormalizedNoise noise = camera.normalizedNoise(n, 0.5);
  const double radial = 0.5 / camera.fx / std::pow(std::cos(theta), 2);
  const double across = 0.5 / camera.fx * std::tan(theta) / theta;
  EXPECT_NEAR(noise.sigma, std::sqrt(radial * across), 1e-9);
  EXPECT_NEAR(noise.elongation, radial / across, 1e-9);
  EXPECT_EQ(wideAngle().normalizedNoise(n, 0.5).sigma, 0.5 / 411);
  EXPECT_EQ(wideAngle().normalizedNoise(n, 0.5).elongation, 1);
}

TEST(CameraModel, TakesWhatDriversWrite) {
  CameraModel c = wideAngle();
  c.setDistortion("plumb_bob", {});  // a rectified camera
  EXPECT_FALSE(c.hasDistortion());
  for (const char* name : {"", "none", "pinhole", "perspective", "Inverse Brown Conrady"}) {
    c.setDistortion(name, {0, 0, 0, 0, 0});
    EXPECT_FALSE(c.hasDistortion());
    EXPECT_EQ(c.distortionName(), "plumb_bob");
    EXPECT_THROW(c.setDistortion(name, {0.1}), std::invalid_argument);  // of which model?
  }
  c.setDistortion("radial-tangential", {-0.2});
  EXPECT_EQ(c.k1, -0.2);
  c.setDistortion("plumb_bob", {-0.2, 0.05, 0.001, 0.002});
  EXPECT_EQ(c.p2, 0.002);
  EXPECT_EQ(c.k3, 0);
  c.setDistortion("rational_polynomial", {-0.2, 0.05, 0.001, 0.002, 0.003});
  EXPECT_EQ(c.distortionCoefficients().size(), 8u);
  c.setDistortion("rational_polynomial", {0.1, 0.2, 0, 0, 0.3, 0.4, 0.5, 0.6, 0, 0, 0, 0, 0, 0});
  EXPECT_EQ(c.k6, 0.6);
  c.setDistortion("plumb_bob", {0.1, 0.2, 0, 0, 0.3, 0.4, 0.5, 0.6});  // taken as OpenCV takes it
  EXPECT_EQ(c.model, DistortionModel::kRationalPolynomial);
  c.setDistortion("fisheye", {0.1, 0.2, 0.3, 0.4, 0});  // as the T265's driver
  EXPECT_EQ(c.k4, 0.4);
  EXPECT_EQ(c.p1, 0);
  // A tilted sensor, a model without its name, and one that is not known.
  EXPECT_THROW(c.setDistortion("rational_polynomial", {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 0, 0.1}),
               std::invalid_argument);
  EXPECT_THROW(c.setDistortion("omni", {0.1}), std::invalid_argument);
}

TEST(CameraModel, ScalingKeepsTheImageCornerInPlace) {
  // The outer corner of the image, half a pixel beyond pixel (0, 0), looks along the same ray at every scale.
  CameraModel camera = wideAngle().undistorted();
  const CameraModel half = camera.scaled(0.5);
  EXPECT_EQ(half.width, 376);
  EXPECT_LT((camera.ray({-0.5, -0.5}) - half.ray({-0.5, -0.5})).norm(), 1e-12);
  EXPECT_LT((camera.ray({751.5, 479.5}) - half.ray({375.5, 239.5})).norm(), 1e-12);
}

class CameraFile : public ::testing::Test {
 protected:
  void TearDown() override { std::filesystem::remove(path_); }

  // What a calibration file holds that differs from a good one by `model` and `coefficients`.
  CameraModel read(const std::string& model, const std::string& coefficients) const {
    std::ofstream(path_)
        << "image_width: 752\nimage_height: 480\ncamera_name: mav\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        << "  data: [410, 0, 370.5, 0, 412, 236.25, 0, 0, 1]\ndistortion_model: " << model
        << "\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: " << coefficients << "\n";
    return readCameraFile(path_);
  }

  const std::string path_ =
      (std::filesystem::temp_directory_path() / ("camera_file_" + std::to_string(::getpid()) + ".yaml")).string();
};

TEST_F(CameraFile, HoldsWhatCalibrationWrote) {
  const CameraModel c = read("plumb_bob", "[-0.28, 0.07, 0.0002, -0.0003, 0.01]"), expected = wideAngle();
  EXPECT_EQ(c.width, 752);
  EXPECT_EQ(c.height, 480);
  EXPECT_EQ(c.K(), expected.K());
  EXPECT_EQ(c.k1, -0.28);
  EXPECT_EQ(c.k2, 0.07);
  EXPECT_EQ(c.p1, 2e-4);
  EXPECT_EQ(c.p2, -3e-4);
  EXPECT_EQ(c.k3, 0.01);
}

TEST_F(CameraFile, RefusesOtherModelsAndMissingFiles) {
  EXPECT_THROW(read("fov", "[0.9]"), std::runtime_error);
  EXPECT_THROW(read("equidistant", "[0.1, 0.2, 0.3, 0.4, 0.5]"), std::runtime_error);
  EXPECT_THROW(read("plumb_bob", "[nan]"), std::runtime_error);
  try {
    readCameraFile("/no/such/camera.yaml");
    ADD_FAILURE() << "a missing file was read";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("no such file"), std::string::npos) << e.what();
  }
}

TEST_F(CameraFile, WritesAndReadsEveryModel) {
  for (const CameraModel& camera : wideCameras()) {
    std::ofstream(path_) << cameraFileText(camera, "mav");
    const CameraModel c = readCameraFile(path_);
    EXPECT_EQ(c.distortionName(), camera.distortionName());
    EXPECT_EQ(c.distortionCoefficients(), camera.distortionCoefficients());
    EXPECT_EQ(c.K(), camera.K());
    EXPECT_EQ(c.max_radius, camera.max_radius);
  }
}

TEST_F(CameraFile, ReadsOpenCvsOwn) {
  std::ofstream(path_) << "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\nfisheye_model: 1\n"
                          "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
                          "   data: [ 280., 0., 320., 0., 281., 240., 0., 0., 1. ]\n"
                          "distortion_coefficients: !!opencv-matrix\n   rows: 4\n   cols: 1\n   dt: d\n"
                          "   data: [ 0.01, -0.02, 0.003, -0.001 ]\n";
  const CameraModel c = readCameraFile(path_);
  EXPECT_EQ(c.model, DistortionModel::kEquidistant);
  EXPECT_EQ(c.fy, 281);
  EXPECT_EQ(c.k4, -0.001);
}

}  // namespace
}  // namespace air_ground_common
