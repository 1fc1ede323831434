// Depth images of scenes made of boxes, and keyframes of a robot that drives round a place.
#pragma once

#include <cmath>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "rgbd_slam/hidden_space.h"

namespace rgbd_slam::testing {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

struct Box {
  Eigen::Vector3d low, high;
};

inline CameraModel camera() {
  CameraModel c;
  c.width = 320;
  c.height = 240;
  c.fx = c.fy = 290;
  c.cx = 159.5;
  c.cy = 119.5;
  return c;
}

/// Looks along `yaw`, `down` below the horizon [rad].
inline Pose cameraAt(const Eigen::Vector3d& p, double yaw, double down) {
  const Eigen::Vector3d z(std::cos(yaw) * std::cos(down), std::sin(yaw) * std::cos(down), -std::sin(down)),
      x(std::sin(yaw), -std::cos(yaw), 0);
  Pose T = Pose::Identity();
  T.linear() << x, z.cross(x), z;
  T.translation() = p;
  return T;
}

inline double along(const Box& box, const Eigen::Vector3d& from, const Eigen::Vector3d& way) {
  double in = 0, out = 1e9;
  for (int i = 0; i < 3; ++i) {
    double a = (box.low[i] - from[i]) / way[i], b = (box.high[i] - from[i]) / way[i];
    if (a > b) std::swap(a, b);
    in = std::max(in, a);
    out = std::min(out, b);
  }
  return in < out && in > 0 ? in : 1e9;
}

/// Noise as of a depth camera; nothing beyond 4.5 m.
inline cv::Mat render(const std::vector<Box>& scene, const Pose& T_map_camera, unsigned seed) {
  const CameraModel c = camera();
  const DepthModel model;
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  cv::Mat depth(c.height, c.width, CV_32F);
  for (int v = 0; v < c.height; ++v) {
    for (int u = 0; u < c.width; ++u) {
      const Eigen::Vector3d way = T_map_camera.linear() * c.unproject({u, v}).homogeneous();
      double z = 1e9;
      for (const Box& box : scene) z = std::min(z, along(box, T_map_camera.translation(), way));
      depth.at<float>(v, u) = z < 4.5 ? static_cast<float>(z + model.sigma(z) * normal(random)) : NAN;
    }
  }
  return depth;
}

/// Round the place, looking at it; `scene_of(i)`: boxes that keyframe i of 16 saw.
template <typename SceneOf>
std::vector<PosedPoints> roundTripIn(const SceneOf& scene_of, const Eigen::Vector2d& middle, double radius,
                                     double height, double pose_noise) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::vector<PosedPoints> keyframes;
  for (int i = 0; i < 16; ++i) {
    const double a = 2 * M_PI * i / 16;
    const Pose T =
        cameraAt({middle.x() + radius * std::cos(a), middle.y() + radius * std::sin(a), height}, a + M_PI, 0.15);
    Pose told = T;
    for (int k = 0; k < 3; ++k) told.translation()[k] += pose_noise * normal(random);
    keyframes.push_back(
        {told, nullptr, i, std::make_shared<const DepthRays>(camera(), render(scene_of(i), T, i), DepthModel{})});
  }
  return keyframes;
}

inline std::vector<PosedPoints> roundTrip(const std::vector<Box>& scene, const Eigen::Vector2d& middle, double radius,
                                          double height, double pose_noise) {
  return roundTripIn([&](int) { return scene; }, middle, radius, height, pose_noise);
}

const Box kFloor{{-20, -20, -1}, {20, 20, 0}};

/// A top of 3 cm on four legs: 1.2 x 0.8 m about the origin.
inline std::vector<Box> table(double height) {
  std::vector<Box> boxes{{{-0.6, -0.4, height - 0.03}, {0.6, 0.4, height}}};
  for (double x : {-0.58, 0.54})
    for (double y : {-0.38, 0.34}) boxes.push_back({{x, y, 0}, {x + 0.04, y + 0.04, height - 0.03}});
  return boxes;
}

inline std::vector<Box> room() {
  return {kFloor,
          {{-3, -3, 0}, {-2.9, 3, 2.5}},
          {{2.9, -3, 0}, {3, 3, 2.5}},
          {{-3, -3, 0}, {3, -2.9, 2.5}},
          {{-3, 2.9, 0}, {3, 3, 2.5}}};
}

}  // namespace rgbd_slam::testing
