// Real recordings that begin in motion. They are not part of the project: without them the tests skip.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "../src/euroc_folder.h"
#include "mav_vo/odometry.h"

using namespace mav_vo;

namespace {

std::string recordings() {
  if (const char* given = std::getenv("AIR_GROUND_DATA")) return given;
  return AIR_GROUND_SOURCE_DIR "/../shared/data";
}

TEST(Recording, EurocStartsInMotion) {
  const std::string path = recordings() + "/euroc_v101_start";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not here (AIR_GROUND_DATA tells where)";
  const EurocFolder folder = readEurocFolder(path);
  OdometrySettings settings;
  settings.imu_noise = {1.7e-4, 2e-3, 1.9e-5, 3e-3};
  Odometry odometry(folder.camera, folder.T_base_camera, folder.T_base_imu, settings);
  std::size_t next = 0;
  const double begin = folder.images.front().stamp;
  FrameResult last;
  for (const auto& image : folder.images) {
    for (; next < folder.imu.size() && folder.imu[next].stamp <= odometry.imuNeededAt(image.stamp) + 0.005; ++next)
      odometry.addImu(folder.imu[next]);
    last = odometry.process(image.stamp, cv::imread(image.path, cv::IMREAD_GRAYSCALE));
    if (image.stamp - begin > 1.0) {
      EXPECT_TRUE(last.pose_valid) << image.stamp - begin << " s: " << last.reason;
    }
  }
  auto poses = odometry.trajectory();
  for (auto& p : poses) p.T_map_body = p.T_map_body * folder.T_base_camera.inverse();
  const auto error =
      air_ground_common::absoluteTrajectoryError(folder.truth, poses, air_ground_common::Alignment::kSimilarity);
  const Eigen::Vector3d bias_error = last.imu_bias.gyro - folder.truth_bias.back().gyro;
  std::printf(
      "ATE %.4f m of %.2f m after similarity alignment, gyro bias off by %.4f rad/s, time offset %.1f +- %.1f ms\n",
      error.rmse, error.path_length, bias_error.norm(), 1e3 * last.time_offset, 1e3 * last.time_offset_stddev);
  EXPECT_LT(error.rmse, 0.01);
  EXPECT_LT(bias_error.norm(), 0.005);
  EXPECT_LT(std::abs(last.time_offset), 0.003);
}

}  // namespace
