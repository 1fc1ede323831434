// Where in the city was this photograph taken? Paper B, section II, from a database of Street View panoramas.
//
//   03_locate_photograph CITY.gpkg PHOTOGRAPH CAMERA.yaml      database: rosrun air_ground build_streetview_db
#include <cstdio>
#include <exception>
#include <memory>
#include <opencv2/imgcodecs.hpp>

#include "air_ground_common/camera_file.h"
#include "streetview_localizer/localizer.h"

int main(int argc, char** argv) try {
  if (argc != 4) {
    std::fprintf(stderr, "usage: %s CITY.gpkg PHOTOGRAPH CAMERA.yaml\n", argv[0]);
    return 2;
  }
  const auto database =
      std::make_shared<const streetview_localizer::StreetviewDatabase>(streetview_localizer::loadDatabase(argv[1]));
  const cv::Mat photograph = cv::imread(argv[2], cv::IMREAD_GRAYSCALE);
  if (photograph.empty()) {
    std::fprintf(stderr, "%s cannot be read as an image\n", argv[2]);
    return 1;
  }
  const streetview_localizer::StreetviewLocalizer localizer(database);
  const auto result = localizer.localize(photograph, air_ground_common::readCameraFile(argv[3]));
  std::printf("%s %s\n", nameOf(result.status), result.reason.c_str());
  if (!result.accepted()) return 1;
  const Eigen::Vector3d p = result.pose.T_world_camera.translation();
  std::printf("%.3f %.3f %.3f\n", p.x(), p.y(), p.z());
  return 0;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
