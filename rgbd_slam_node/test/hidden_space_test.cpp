// Where a table hides what is above the floor below it, from depth images of scenes made of boxes.
#include "rgbd_slam/hidden_space.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace rgbd_slam {
namespace {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

struct Box {
  Eigen::Vector3d low, high;
};

CameraModel camera() {
  CameraModel c;
  c.width = 320;
  c.height = 240;
  c.fx = c.fy = 290;
  c.cx = 159.5;
  c.cy = 119.5;
  return c;
}

/// Looks along `yaw`, `down` below the horizon [rad].
Pose cameraAt(const Eigen::Vector3d& p, double yaw, double down) {
  const Eigen::Vector3d z(std::cos(yaw) * std::cos(down), std::sin(yaw) * std::cos(down), -std::sin(down)),
      x(std::sin(yaw), -std::cos(yaw), 0);
  Pose T = Pose::Identity();
  T.linear() << x, z.cross(x), z;
  T.translation() = p;
  return T;
}

double along(const Box& box, const Eigen::Vector3d& from, const Eigen::Vector3d& way) {
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
cv::Mat render(const std::vector<Box>& scene, const Pose& T_map_camera, unsigned seed) {
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

/// Round the place, looking at it.
std::vector<PosedPoints> roundTrip(const std::vector<Box>& scene, const Eigen::Vector2d& middle, double radius,
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
        {told, nullptr, i, std::make_shared<const DepthRays>(camera(), render(scene, T, i), DepthModel{})});
  }
  return keyframes;
}

const Box kFloor{{-20, -20, -1}, {20, 20, 0}};

/// A top of 3 cm on four legs: 1.2 x 0.8 m about the origin.
std::vector<Box> table(double height) {
  std::vector<Box> boxes{{{-0.6, -0.4, height - 0.03}, {0.6, 0.4, height}}};
  for (double x : {-0.58, 0.54})
    for (double y : {-0.38, 0.34}) boxes.push_back({{x, y, 0}, {x + 0.04, y + 0.04, height - 0.03}});
  return boxes;
}

std::vector<Box> room() {
  return {kFloor,
          {{-3, -3, 0}, {-2.9, 3, 2.5}},
          {{2.9, -3, 0}, {3, 3, 2.5}},
          {{-3, -3, 0}, {3, -2.9, 2.5}},
          {{-3, 2.9, 0}, {3, 3, 2.5}}};
}

/// Share of places of the floor in the rectangle where something hides what is above, and the mean of where it begins.
std::pair<double, double> hiddenShare(const HiddenSpace& space, const Eigen::Vector2d& low,
                                      const Eigen::Vector2d& high) {
  int hidden = 0, all = 0;
  double sum = 0;
  for (double x = low.x(); x < high.x(); x += 0.02) {
    for (double y = low.y(); y < high.y(); y += 0.02, ++all) {
      const float from = space.hiddenFrom(Eigen::Vector3d(x, y, 0.004).cast<float>());
      if (std::isnan(from)) continue;
      ++hidden;
      sum += from;
    }
  }
  return {static_cast<double>(hidden) / all, hidden > 0 ? sum / hidden : 0};
}

TEST(HiddenSpace, ATableHidesWhatIsAboveTheFloorBelowIt) {
  for (const double height : {0.45, 0.74}) {
    std::vector<Box> scene = room();
    for (const Box& box : table(height)) scene.push_back(box);
    for (const double noise : {0.0, 0.01}) {
      HiddenSpace space;
      space.update(roundTrip(scene, {0, 0}, 1.6, 0.35, noise));
      const auto [below, from] = hiddenShare(space, {-0.5, -0.3}, {0.5, 0.3});
      EXPECT_GT(below, 0.9) << height << " m, poses off by " << noise;
      EXPECT_NEAR(from, height - 0.03, 0.03);
      // A surface hides what is up to 0.8 m behind it, where nobody looks from elsewhere.
      EXPECT_LT(hiddenShare(space, {1.4, -1.2}, {2.4, 1.2}).first, 0.02) << "beside it";
      EXPECT_TRUE(std::isnan(space.hiddenFrom({0, 0, static_cast<float>(height)}))) << "above it";
    }
  }
}

TEST(HiddenSpace, AnOpenFloorIsNotHiddenWhereverOneLooked) {
  HiddenSpace in_room, in_hall, before_boxes;
  in_room.update(roundTrip(room(), {0, 0}, 1.6, 0.35, 0.01));
  EXPECT_LT(hiddenShare(in_room, {-1, -1}, {1, 1}).first, 0.01);
  in_hall.update(roundTrip({kFloor}, {0, 0}, 1.6, 0.35, 0.01));
  EXPECT_LT(hiddenShare(in_hall, {-1, -1}, {1, 1}).first, 0.01) << "rays that end nowhere";
  std::vector<Box> boxes = room();
  boxes.push_back({{-0.3, -0.3, 0}, {0.3, 0.3, 0.3}});
  boxes.push_back({{-0.2, 0.7, 0}, {0.2, 1.0, 0.8}});
  before_boxes.update(roundTrip(boxes, {0, 0}, 1.6, 0.35, 0.01));
  EXPECT_LT(hiddenShare(before_boxes, {0.4, -1}, {1, 1}).first, 0.03);
}

TEST(HiddenSpace, FollowsItsKeyframes) {
  std::vector<Box> scene = room();
  for (const Box& box : table(0.45)) scene.push_back(box);
  auto keyframes = roundTrip(scene, {0, 0}, 1.6, 0.35, 0);
  HiddenSpace at_once, grown;
  const Eigen::Vector3d shift(0.5, -0.4, 0.2);
  for (PosedPoints& k : keyframes) k.T_map_camera.pretranslate(-shift);
  grown.update({keyframes.begin(), keyframes.begin() + 5});
  grown.update(keyframes);
  for (PosedPoints& k : keyframes) k.T_map_camera.pretranslate(shift);
  grown.update(keyframes);
  at_once.update(keyframes);
  for (double x = -1; x < 1; x += 0.03) {
    for (double y = -1; y < 1; y += 0.03) {
      const Eigen::Vector3f p = Eigen::Vector3d(x, y, 0).cast<float>();
      const float a = grown.hiddenFrom(p), b = at_once.hiddenFrom(p);
      ASSERT_TRUE(a == b || (std::isnan(a) && std::isnan(b))) << p.transpose();
    }
  }
  grown.update({});
  EXPECT_TRUE(std::isnan(grown.hiddenFrom({0, 0, 0})));
}

TEST(DepthRays, WhatIsNotKnownIsNotFree) {
  const CameraModel c = camera();
  cv::Mat depth(c.height, c.width, CV_32F, cv::Scalar(2.0f));
  depth.at<float>(1, 1) = NAN;
  depth.at<float>(0, 3) = 1.2f;
  DepthModel model;
  const DepthRays rays(c, depth, model);
  ASSERT_EQ(rays.rays.size(), 106u * 80u);
  EXPECT_EQ(rays.rays[0].free, 0);
  EXPECT_FLOAT_EQ(rays.rays[1].occupied, 1.2f);
  EXPECT_NEAR(rays.rays[1].free, 1.2 - 3 * model.sigma(1.2), 1e-6);
  EXPECT_NEAR(rays.rays[1].x, (4 - c.cx) / c.fx, 1e-6);
  depth.setTo(NAN);
  EXPECT_TRUE(DepthRays(c, depth, model).rays.empty());
}

}  // namespace
}  // namespace rgbd_slam
