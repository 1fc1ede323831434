// Where a table hides what is above the floor below it, from depth images of scenes made of boxes.
#include "rgbd_slam/hidden_space.h"

#include <gtest/gtest.h>

#include <cmath>

#include "depth_scene.h"

namespace rgbd_slam {
namespace {

using namespace testing;  // NOLINT: the scenes of depth_scene.h

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

bool sameHidden(const HiddenSpace& a, const HiddenSpace& b) {
  for (double x = -1.5; x < 1.5; x += 0.03) {
    for (double y = -1.5; y < 1.5; y += 0.03) {
      const Eigen::Vector3f p = Eigen::Vector3d(x, y, 0.004).cast<float>();
      const float of_a = a.hiddenFrom(p), of_b = b.hiddenFrom(p);
      if (!(of_a == of_b || (std::isnan(of_a) && std::isnan(of_b)))) return false;
    }
  }
  return true;
}

TEST(HiddenSpace, AKeyframeThatIsReplacedLeavesNothing) {
  std::vector<Box> scene = room();
  for (const Box& box : table(0.45)) scene.push_back(box);
  auto keyframes = roundTrip(scene, {0, 0}, 1.6, 0.35, 0.01);
  HiddenSpace grown;
  grown.update(keyframes);
  for (int i = 0; i < 8; ++i) {
    PosedPoints& k = keyframes[2 * i];
    k.keyframe += 100;
    k.T_map_camera.pretranslate(Eigen::Vector3d(0.04, 0.01 * i, 0.03));
    if (i == 5) k.rays = keyframes[3].rays;
    grown.update(keyframes);
    HiddenSpace fresh;
    fresh.update(keyframes);
    ASSERT_TRUE(sameHidden(grown, fresh)) << i;
  }
}

TEST(HiddenSpace, CountsManyRays) {
  const auto keyframe = [](int number, int times, double low, double high, float free, float occupied) {
    DepthRays rays;
    for (double z = low; z < high; z += 0.01)
      rays.rays.insert(rays.rays.end(), times, {0, static_cast<float>(0.2 - z), free, occupied});
    return PosedPoints{cameraAt({0, 0, 0.2}, 0, 0), nullptr, number, std::make_shared<const DepthRays>(rays)};
  };
  // Free layers above the floor 1 m ahead, one above them that ten rays call hidden, and 2^16 that went through it.
  const PosedPoints below = keyframe(0, 1, 0.06, 0.3, 2, 5), hides = keyframe(1, 10, 0.311, 0.32, 0.8F, 0.85F),
                    many = keyframe(2, 1 << 16, 0.311, 0.32, 2, 5);
  HiddenSpace space;
  space.update({below, hides});
  const Eigen::Vector3f p(1.01F, 0.01F, 0);
  EXPECT_NEAR(space.hiddenFrom(p), 0.3, 0.021);
  space.update({below, hides, many});
  EXPECT_TRUE(std::isnan(space.hiddenFrom(p)));
  space.update({below, hides});
  EXPECT_NEAR(space.hiddenFrom(p), 0.3, 0.021);
}

TEST(SeenKeyframes, OnlyThoseThatChangedAreCast) {
  std::vector<PosedPoints> keyframes;
  for (int i = 0; i < 16; ++i)
    keyframes.push_back({cameraAt({0.1 * i, 0, 0}, 0, 0), nullptr, i, std::make_shared<const DepthRays>()});
  SeenKeyframes seen;
  int cleared = 0, added = 0, taken = 0;
  const auto update = [&] {
    cleared = added = taken = 0;
    seen.update(
        keyframes, [&] { ++cleared; },
        [&](const Pose&, const DepthRays&, int sign = 1) { ++(sign > 0 ? added : taken); });
  };
  update();
  EXPECT_EQ(added, 16);
  keyframes[5].keyframe = 20;
  update();
  EXPECT_EQ(added, 1) << "replaced";
  EXPECT_EQ(taken, 1);
  keyframes[6].T_map_camera.translation().x() += 0.03;
  keyframes[7].T_map_camera.translation().x() += 0.02;
  keyframes.pop_back();
  update();
  EXPECT_EQ(added, 1) << "moved";
  EXPECT_EQ(taken, 2);
  EXPECT_EQ(cleared, 0);
  for (int i = 0; i < 10; ++i) keyframes[i].T_map_camera.translation().y() += 1;
  update();
  EXPECT_EQ(cleared, 1) << "most are elsewhere: anew is less work";
  EXPECT_EQ(added, 15);
  EXPECT_EQ(taken, 0);
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
