// A street with one wall, painted from a formula, as panoramas see it; and its city model.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>

#include "streetview_localizer/city_model.h"
#include "streetview_localizer/panorama_views.h"

namespace streetview_localizer {

/// Fixed noise on a grid of 1 / 8 m, smoothed between: corners and blobs for SIFT, no repetition.
inline double noise(double x, double y) {
  const auto hash = [](long i, long j) {
    std::uint32_t h = static_cast<std::uint32_t>(i) * 374761393u + static_cast<std::uint32_t>(j) * 668265263u;
    h = (h ^ (h >> 13)) * 1274126177u;
    return static_cast<double>((h ^ (h >> 16)) & 255u);
  };
  const double u = 8 * x, v = 8 * y;
  const long i = static_cast<long>(std::floor(u)), j = static_cast<long>(std::floor(v));
  const double a = u - i, b = v - j;
  return (1 - b) * ((1 - a) * hash(i, j) + a * hash(i + 1, j)) +
         b * ((1 - a) * hash(i, j + 1) + a * hash(i + 1, j + 1));
}

/// Wall y = 10 from x = -30 to 30, z = 0 to 12; a car before it from x = 1 to 5, y = 7, up to z = 1.5, which no model
/// holds.
inline cv::Mat wallPanorama(int width, const air_ground_common::Pose& T_world_panorama, bool car) {
  cv::Mat image(width / 2, width, CV_8UC3, cv::Scalar(230, 200, 170));
  const Eigen::Vector3d o = T_world_panorama.translation();
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      const Eigen::Vector3d d = T_world_panorama.linear() * panoramaRay(image.size(), {double(u), double(v)});
      if (d.y() <= 0.01) continue;
      const Eigen::Vector3d wall = o + (10 - o.y()) / d.y() * d, front = o + (7 - o.y()) / d.y() * d;
      double grey = -1;
      if (std::abs(wall.x()) < 30 && wall.z() > 0 && wall.z() < 12) grey = noise(wall.x(), wall.z());
      if (car && front.x() > 1 && front.x() < 5 && front.z() > 0 && front.z() < 1.5)
        grey = noise(front.x() + 100, front.z());
      if (grey >= 0) image.at<cv::Vec3b>(v, u) = cv::Vec3b::all(static_cast<std::uint8_t>(grey));
    }
  return image;
}

inline CityModel wallModel() {
  CityModel m;
  m.mesh.vertices = {{-30, 10, 0}, {30, 10, 0}, {30, 10, 12}, {-30, 10, 12}};
  m.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  m.surface = {Surface::kWall, Surface::kWall};
  m.building = {0, 0};
  m.building_ids = {"wall"};
  return m;
}

/// At (x, 0, 2.5), looking north-east.
inline air_ground_common::Pose panoramaPose(double x) {
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  T.translation() << x, 0, 2.5;
  T.linear() = Eigen::AngleAxisd(0.9, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return T;
}

}  // namespace streetview_localizer
