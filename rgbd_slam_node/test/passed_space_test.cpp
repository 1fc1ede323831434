// Who walks before a depth camera leaves no body in the map, and what stands stays.
#include "rgbd_slam/passed_space.h"

#include <gtest/gtest.h>

#include "depth_scene.h"

namespace rgbd_slam {
namespace {

using testing::Box;

/// Share of points of a box's sides and top that are gone.
double goneShare(const PassedSpace& space, const Box& box) {
  int gone = 0, all = 0;
  for (double x = box.low.x(); x <= box.high.x() + 1e-9; x += 0.02) {
    for (double y = box.low.y(); y <= box.high.y() + 1e-9; y += 0.02) {
      for (double z = box.low.z(); z <= box.high.z() + 1e-9; z += 0.02) {
        const Eigen::Vector3d p(x, y, z);
        const double inside = ((p - box.low).cwiseMin(box.high - p)).minCoeff();
        if (inside > 0.005) continue;
        gone += space.isGone(p.cast<float>());
        ++all;
      }
    }
  }
  return static_cast<double>(gone) / all;
}

TEST(PassedSpace, WhoWalkedByIsGoneWheneverItWas) {
  for (const double noise : {0.0, 0.01}) {
    for (const int when : {1, 13}) {  // in the first look at the place, or after all others
      const Box person{{-0.2, -0.15, 0.12}, {0.2, 0.15, 0.7}};
      PassedSpace space;
      space.update(testing::roundTripIn(
          [&](int i) {
            std::vector<Box> scene = testing::room();
            if (i == when || i == when + 1) scene.push_back(person);
            return scene;
          },
          {0, 0}, 1.6, 0.4, noise));
      EXPECT_GT(goneShare(space, person), 0.9) << "at " << when << ", poses off by " << noise;
    }
  }
}

TEST(PassedSpace, WhatStandsStays) {
  for (const double noise : {0.0, 0.01}) {
    std::vector<Box> scene = testing::room();
    const std::vector<Box> table = testing::table(0.7);
    for (const Box& box : table) scene.push_back(box);
    const Box screen{{0.9, -0.5, 0}, {0.92, 0.5, 1.2}};  // thinner than a cube, seen from both sides
    scene.push_back(screen);
    PassedSpace space;
    space.update(testing::roundTrip(scene, {0.3, 0}, 2.0, 0.5, noise));
    for (std::size_t i = 0; i < scene.size(); ++i) {
      if (i == 0) continue;  // the floor: below
      EXPECT_LT(goneShare(space, scene[i]), 0.01) << "box " << i << ", poses off by " << noise;
    }
    EXPECT_EQ(goneShare(space, {{-2, -2, -0.005}, {2, 2, 0.005}}), 0) << "floor";
  }
}

TEST(PassedSpace, FollowsItsKeyframes) {
  const Box person{{-0.2, -0.15, 0.12}, {0.2, 0.15, 0.7}};
  auto keyframes = testing::roundTripIn(
      [&](int i) {
        std::vector<Box> scene = testing::room();
        if (i < 2) scene.push_back(person);
        return scene;
      },
      {0, 0}, 1.6, 0.4, 0);
  PassedSpace space;
  space.update(keyframes);
  ASSERT_GT(goneShare(space, person), 0.9);
  const Eigen::Vector3d shift(7, 0, 0);  // a loop is closed
  for (PosedPoints& k : keyframes) k.T_map_camera.pretranslate(shift);
  space.update(keyframes);
  EXPECT_EQ(goneShare(space, person), 0);
  EXPECT_GT(goneShare(space, {person.low + shift, person.high + shift}), 0.9);
  space.update({keyframes[0], keyframes[1]});
  EXPECT_EQ(goneShare(space, {person.low + shift, person.high + shift}), 0) << "only two have looked";
}

TEST(PassedSpace, AKeyframeThatIsReplacedLeavesNothing) {
  const Box person{{-0.2, -0.15, 0.12}, {0.2, 0.15, 0.7}};
  auto keyframes = testing::roundTripIn(
      [&](int i) {
        std::vector<Box> scene = testing::room();
        if (i % 4 == 0) scene.push_back(person);
        return scene;
      },
      {0, 0}, 1.6, 0.4, 0.01);
  PassedSpace grown;
  grown.update(keyframes);
  for (int i = 0; i < 8; ++i) {
    keyframes[2 * i].keyframe += 100;
    keyframes[2 * i].T_map_camera.pretranslate(Eigen::Vector3d(0.04, 0.01 * i, 0.03));
    grown.update(keyframes);
    PassedSpace fresh;
    fresh.update(keyframes);
    for (double x = -0.5; x < 0.5; x += 0.02)
      for (double y = -0.5; y < 0.5; y += 0.02)
        for (double z = 0; z < 0.9; z += 0.02) {
          const Eigen::Vector3f p = Eigen::Vector3d(x, y, z).cast<float>();
          ASSERT_EQ(grown.isGone(p), fresh.isGone(p)) << i << ": " << p.transpose();
        }
  }
}

// In a yard depth may reach 60 m: what is out there is no part of the cloud.
TEST(PassedSpace, NothingIsKeptOfWhatIsFarBeyondTheCloud) {
  const auto tiles = [](float nearest, float farthest) {
    std::vector<PosedPoints> keyframes;
    for (int i = 0; i < 20; ++i) {
      DepthRays rays;
      for (int k = 0; k < 2000; ++k) {
        const float depth = nearest + (farthest - nearest) * static_cast<float>(k * 37 % 2000) / 2000;
        rays.rays.push_back({0.02F * (k % 50 - 25), 0.02F * (k / 50 - 20), 6, depth});
      }
      keyframes.push_back(
          {testing::cameraAt({0.5 * i, 0, 0.5}, 0.3 * i, 0.1), nullptr, i, std::make_shared<const DepthRays>(rays)});
    }
    PassedSpace space(4);
    space.update(keyframes);
    return space.tiles();
  };
  EXPECT_EQ(tiles(20, 60), tiles(1e3F, 1e4F));
  EXPECT_GT(tiles(4, 4.5), tiles(20, 60)) << "near ones count";
}

}  // namespace
}  // namespace rgbd_slam
