// Folders in the EuRoC layout, of other cameras and other truth than EuRoC's.
#include "../tools/euroc_folder.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>

namespace mav_vo {
namespace {

namespace fs = std::filesystem;

class EurocFolderTest : public ::testing::Test {
 protected:
  EurocFolderTest() : path_(fs::temp_directory_path() / ("euroc_folder_test_" + std::to_string(getpid()))) {
    fs::remove_all(path_);
    write("cam0/data.csv", "#timestamp [ns],filename\n1520530308199447626,a.png\n");
    write("imu0/data.csv", "#timestamp [ns],w,,,a,,\n1520530308199447000,0.1,0.2,0.3,0,0,9.8\n");
    write("imu0/sensor.yaml", mounting());
  }
  ~EurocFolderTest() override { fs::remove_all(path_); }

  static std::string mounting() {
    return "T_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n";
  }
  void writeCamera(const std::string& lens) {
    write("cam0/sensor.yaml", "%YAML:1.0\n" + mounting() +
                                  "camera_model: pinhole\nresolution: [512, 512]\nintrinsics: [191, 191, 255, 257]\n" +
                                  lens);
  }
  void write(const std::string& name, const std::string& text) {
    const fs::path file = path_ / "mav0" / name;
    fs::create_directories(file.parent_path());
    std::ofstream(file) << text;
  }
  EurocFolder read() const { return readEurocFolder(path_.string()); }

  const fs::path path_;
};

// As of TUM-VI.
TEST_F(EurocFolderTest, KnowsTheLensByItsName) {
  writeCamera("distortion_model: equidistant\ndistortion_coefficients: [0.0034, 0.00071, -0.0021, 0.0002]\n");
  const air_ground_common::CameraModel camera = read().camera;
  EXPECT_EQ(camera.distortionName(), "equidistant");
  const Eigen::Vector2d pixel(400, 400);
  const double radius = (pixel - Eigen::Vector2d(255, 257)).norm() / 191;
  const double angle = std::atan(camera.unproject(pixel).norm());
  const double a2 = angle * angle;
  EXPECT_NEAR(angle * (1 + a2 * (0.0034 + a2 * (0.00071 + a2 * (-0.0021 + a2 * 0.0002)))), radius, 1e-6);
  EXPECT_GT(angle, 1.0);
}

TEST_F(EurocFolderTest, ReadsEurocsOwn) {
  writeCamera("distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n");
  const air_ground_common::CameraModel camera = read().camera;
  EXPECT_EQ(camera.distortionName(), "plumb_bob");
  EXPECT_EQ(camera.k1, -0.28);
  EXPECT_EQ(camera.p2, 1.8e-05);
}

TEST_F(EurocFolderTest, RefusesALensThatItDoesNotKnow) {
  writeCamera("distortion_model: omnidirectional\ndistortion_coefficients: [1, 2, 3, 4]\n");
  try {
    read();
    FAIL() << "read";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("cam0/sensor.yaml"), std::string::npos) << e.what();
    EXPECT_NE(std::string(e.what()).find("omnidirectional"), std::string::npos) << e.what();
  }
}

TEST_F(EurocFolderTest, TruthIsThatOfTheMotionCaptureToo) {
  writeCamera("distortion_model: none\n");
  EXPECT_TRUE(read().truth.empty());
  write("mocap0/data.csv", "#timestamp,p,,,q_w,,,\n1520530308199447626,1,2,3,0,0,0,1\n");
  const EurocFolder folder = read();
  ASSERT_EQ(folder.truth.size(), 1u);
  EXPECT_TRUE(folder.truth_bias.empty());
  EXPECT_EQ(folder.truth.front().T_map_body.translation(), Eigen::Vector3d(1, 2, 3));
  EXPECT_NEAR(folder.truth.front().T_map_body.linear()(0, 0), -1, 1e-9);
  EXPECT_DOUBLE_EQ(folder.truth.front().stamp, folder.images.front().stamp);
}

}  // namespace
}  // namespace mav_vo
