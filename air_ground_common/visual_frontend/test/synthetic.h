// Synthetic cameras, points and images with exact truth, for the tests and benchmarks of the visual front end.
#pragma once

#include <algorithm>
#include <functional>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "air_ground_common/testing/camera.h"
#include "air_ground_common/testing/random.h"
#include "visual_frontend/types.h"

namespace visual_frontend::synthetic {

inline CameraModel camera(bool distorted = true) {
  const Eigen::Vector4d distortion(-0.2, 0.06, 0.001, -0.0007);
  return air_ground_common::testing::vgaCamera({525, 520, 318, 243}, (distorted ? 1 : 0) * distortion);
}

using air_ground_common::testing::Random;

/// Any rotation and a position within 5 m.
inline Pose randomPose(Random& random) {
  Pose T = Pose::Identity();
  T.linear() = air_ground_common::expSO3(random.vector(1.7));
  T.translation() = random.vector(5);
  return T;
}

/// Point in the view of a camera, 1 to 6 m away, in the map.
inline Eigen::Vector3d visiblePoint(Random& random, const Pose& T_map_camera) {
  const double z = random.uniform(1, 6);
  return T_map_camera * Eigen::Vector3d(random.uniform(-0.55, 0.55) * z, random.uniform(-0.42, 0.42) * z, z);
}

/// Smooth random texture with corners at several scales, CV_8UC1.
inline cv::Mat texture(int size, unsigned seed) {
  cv::Mat sum = cv::Mat::zeros(size, size, CV_32F);
  cv::RNG rng(seed);
  for (const int cell : {4, 9, 21, 47}) {
    cv::Mat noise(size / cell + 2, size / cell + 2, CV_32F), large;
    rng.fill(noise, cv::RNG::UNIFORM, -1.f, 1.f);
    cv::resize(noise, large, cv::Size(size, size), 0, 0, cell > 9 ? cv::INTER_NEAREST : cv::INTER_CUBIC);
    sum += large * (cell > 9 ? 30.f : 22.f);
  }
  cv::Mat image;
  cv::Mat(sum + 128.f).convertTo(image, CV_8U);
  cv::GaussianBlur(image, image, cv::Size(3, 3), 0.8);
  return image;
}

/// View of the textured plane z = 0 of the map (texture centre at the origin, `metres` wide) from the pose that the
/// camera has at each row. `depth` (CV_32F, z in the camera) if given. Pixels that miss the plane are grey and of depth
/// 0.
inline cv::Mat renderPlaneByRows(const CameraModel& camera, const std::function<Pose(int)>& T_map_camera_of_row,
                                 const cv::Mat& texture, double metres, cv::Mat* depth = nullptr) {
  cv::Mat map_x(camera.height, camera.width, CV_32F, cv::Scalar(-1)),
      map_y(camera.height, camera.width, CV_32F, cv::Scalar(-1)), image;
  if (depth) *depth = cv::Mat::zeros(camera.height, camera.width, CV_32F);
  const double scale = texture.cols / metres;
  for (int v = 0; v < camera.height; ++v) {
    const Pose T_map_camera = T_map_camera_of_row(v);
    for (int u = 0; u < camera.width; ++u) {
      const Eigen::Vector3d ray = camera.unproject(Eigen::Vector2d(u, v)).homogeneous();
      const Eigen::Vector3d direction = T_map_camera.linear() * ray;
      const double z = -T_map_camera.translation().z() / direction.z();
      if (!(z > 0)) continue;
      const Eigen::Vector3d p = T_map_camera.translation() + z * direction;
      map_x.at<float>(v, u) = static_cast<float>(p.x() * scale + texture.cols / 2.0);
      map_y.at<float>(v, u) = static_cast<float>(p.y() * scale + texture.rows / 2.0);
      if (depth) depth->at<float>(v, u) = static_cast<float>(z);
    }
  }
  cv::remap(texture, image, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar(100));
  return image;
}

/// The same with all rows at once.
inline cv::Mat renderPlane(const CameraModel& camera, const Pose& T_map_camera, const cv::Mat& texture, double metres,
                           cv::Mat* depth = nullptr) {
  return renderPlaneByRows(
      camera, [&](int) { return T_map_camera; }, texture, metres, depth);
}

/// Points p with n . p = d.
using Plane = std::pair<Eigen::Vector3d, double>;

/// z of the nearest plane before the camera in a pixel; infinite where there is none.
inline double depthOfPlanes(const std::vector<Plane>& planes, const CameraModel& camera, const Pose& T_world_camera,
                            const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d ray = T_world_camera.linear() * camera.unproject(pixel).homogeneous();
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& [n, d] : planes) {
    const double z = (d - n.dot(T_world_camera.translation())) / n.dot(ray);
    if (z > 0) nearest = std::min(nearest, z);
  }
  return nearest;
}

/// Camera above the plane looking down at (x, y) from height h, turned by yaw and tilted by pitch [rad].
inline Pose above(double x, double y, double h, double yaw = 0, double pitch = 0) {
  Pose T = Pose::Identity();
  T.linear() = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
               Eigen::AngleAxisd(M_PI + pitch, Eigen::Vector3d::UnitX()).toRotationMatrix();
  T.translation() = Eigen::Vector3d(x, y, h);
  return T;
}

}  // namespace visual_frontend::synthetic
