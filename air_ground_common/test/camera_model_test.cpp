#include "air_ground_common/camera_model.h"

#include <gtest/gtest.h>
#include <unistd.h>

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
  EXPECT_THROW(read("equidistant", "[0.1, 0.2, 0.3, 0.4]"), std::runtime_error);
  EXPECT_THROW(read("rational_polynomial", "[1, 2, 3, 4, 5, 6, 7, 8]"), std::runtime_error);
  EXPECT_THROW(read("plumb_bob", "[nan]"), std::runtime_error);
  try {
    readCameraFile("/no/such/camera.yaml");
    ADD_FAILURE() << "a missing file was read";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("no such file"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace air_ground_common
