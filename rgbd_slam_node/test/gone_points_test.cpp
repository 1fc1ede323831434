// What stood before the camera and went does not stay in the ground cloud.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "../src/dense_keyframes.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::Robot;
namespace synthetic = simulated::synthetic;

/// A wall 2 m away, with noise, and before it a box, 1.4 m away and 100 pixels wide. `open`: a low wall, above which
/// all is too far away for a depth.
struct Wall : ::testing::Test {
  explicit Wall(bool open_above = false) : open(open_above) {
    settings.max_fused_frames = 4;
    dense = std::make_unique<DenseKeyframes>(camera, settings);
    map.addKeyframe({});
    begin();
  }
  cv::Mat depth(bool box, int shift = 0) {
    cv::Mat image(camera.height, camera.width, CV_32F, cv::Scalar(2));
    if (open) image.rowRange(0, 280) = NAN;
    if (box) image(cv::Rect(200 + shift, 150, 100, 100)) = 1.4f;
    for (int v = 0; v < image.rows; ++v)
      for (float& z : cv::Mat_<float>(image.row(v))) z += static_cast<float>(random.gauss(settings.depth.sigma(z)));
    return image;
  }
  /// The box stands there while the keyframe is refined, and for longer.
  void begin() {
    dense->begin(0, 0, depth(true), cv::Mat(camera.height, camera.width, CV_8U, cv::Scalar(80)), Pose::Identity(),
                 rows);
    for (int i = 0; i < 8; ++i) {
      dense->fuse(depth(true), Pose::Identity(), rows);
      look(depth(true));
    }
    begun = near();
    ASSERT_GT(begun, 500);
  }
  bool look(const cv::Mat& image, const Pose& T_frame_keyframe = Pose::Identity()) {
    return dense->lookThrough(0, image, T_frame_keyframe, rows);
  }
  /// Points nearer than the wall.
  int near() const {
    int count = 0;
    for (const PosedPoints& keyframe : dense->posed(map))
      for (const auto& p : *keyframe.points) count += p.position.z() < 1.7f;
    return count;
  }
  int points() const { return static_cast<int>(dense->posed(map).front().points->size()); }

  const bool open;
  CameraModel camera = synthetic::camera(false);
  SlamSettings settings;
  visual_frontend::Map map;
  visual_frontend::RollingShutter rows{camera, 0};
  synthetic::Random random{3};
  std::unique_ptr<DenseKeyframes> dense;
  int begun = 0;
};

TEST_F(Wall, WhatLaterImagesSeeThroughGoes) {
  const int wall = points() - begun;
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(look(depth(false)));
  EXPECT_EQ(near(), begun) << "an image or two may err";
  EXPECT_TRUE(look(depth(false)));
  EXPECT_EQ(near(), 0);
  EXPECT_EQ(points(), wall) << "and nothing else";
  EXPECT_FALSE(look(depth(false)));
}

TEST_F(Wall, WhatIsSeenBetweenStays) {
  for (int i = 0; i < 30; ++i) EXPECT_FALSE(look(depth(i % 4 == 3)));
  EXPECT_EQ(near(), begun);
}

TEST_F(Wall, WhatIsHiddenOrNotMeasuredStays) {
  for (int i = 0; i < 10; ++i) {
    EXPECT_FALSE(look(cv::Mat(camera.height, camera.width, CV_32F, cv::Scalar(1))));
    EXPECT_FALSE(look(cv::Mat(camera.height, camera.width, CV_32F, cv::Scalar(NAN))));
  }
  EXPECT_EQ(near(), begun);
}

struct LowWall : Wall {
  LowWall() : Wall(true) {}
};

TEST_F(LowWall, WhoStoodBeforeTheSkyGoes) {
  const int wall = points() - begun;
  for (int i = 0; i < 7; ++i) EXPECT_FALSE(look(depth(false)));
  EXPECT_TRUE(look(depth(false)));
  EXPECT_EQ(near(), 0);
  EXPECT_EQ(points(), wall) << "and nothing else";
}

// In one keyframe and some frames after it, and never before.
TEST_F(LowWall, WhoHasJustComeIsLeftOutWhereNobodyStoodBefore) {
  for (const bool before : {true, false}) {
    dense->clear();
    for (double t = 0; t < 0.85; t += 0.2) dense->remember(t, depth(before), Pose::Identity(), rows);
    dense->begin(0, 1.0, depth(true), cv::Mat(camera.height, camera.width, CV_8U, cv::Scalar(80)), Pose::Identity(),
                 rows);
    for (int i = 0; i < 2; ++i) dense->fuse(depth(true), Pose::Identity(), rows);
    EXPECT_EQ(near() > 0.9 * begun, before);
    if (!before) EXPECT_EQ(near(), 0);
    EXPECT_GT(points(), begun) << "the wall";
  }
}

TEST_F(LowWall, WhatGivesNoDepthFromElsewhereStays) {
  Pose nearer = Pose::Identity(), aside = Pose::Identity();
  nearer.translation().z() = -0.5;  // 0.9 m before the box
  aside.linear() = Eigen::AngleAxisd(0.35, Eigen::Vector3d::UnitY()).toRotationMatrix();
  aside.translation() = Eigen::Vector3d(0, 0, 1.4) - aside.linear() * Eigen::Vector3d(0, 0, 1.4);  // round the box
  for (const Pose& T_frame_keyframe : {nearer, aside})
    for (int i = 0; i < 20; ++i) look(depth(false), T_frame_keyframe);
  EXPECT_EQ(near(), begun);
}

TEST_F(Wall, APoseThatIsALittleOffErodesNoRims) {
  const int all = points();
  Pose T_frame_keyframe = Pose::Identity();
  T_frame_keyframe.translation() = Eigen::Vector3d(0.008, 0, 0.02);  // 3 px
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(look(depth(true), T_frame_keyframe));
  EXPECT_EQ(points(), all);
}

TEST_F(Wall, FromFarAwayNothingIsSaidOfThinThings) {
  Pose T_frame_keyframe = Pose::Identity();
  T_frame_keyframe.translation().z() = 1.6;  // the box would be 3 m away, the wall 3.6 m
  const cv::Mat far(camera.height, camera.width, CV_32F, cv::Scalar(3.6));
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(look(far, T_frame_keyframe));
  EXPECT_EQ(near(), begun);
}

TEST(GonePoints, WhoStoodBeforeAStandingRobotLeavesTheCloud) {
  Robot robot;
  robot.walls = true;
  robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                                          air_ground_common::opticalFromForwardBody().transpose();
  robot.rest = 1e3;
  Slam slam(robot.camera, robot.mounting, {});
  synthetic::Random random(4);
  const auto see = [&](int i) {
    auto frame = robot.frame(0.1 * i, random);
    if (i < 25) frame.depth(cv::Rect(250, 100, 120, 300)) = 0.8f;
    slam.addImu(robot.imu(0.1 * i, random));
    return slam.process(0.1 * i, frame.gray, cv::Mat(), frame.depth);
  };
  const auto near = [&] {
    int count = 0;
    for (const PosedPoints& keyframe : slam.posedPoints())
      for (const auto& p : *keyframe.points) count += std::abs(p.position.z() - 0.8f) < 0.05f;
    return count;
  };
  int gone = 0;
  for (int i = 0; i < 25; ++i) gone += see(i).points_gone;
  EXPECT_EQ(gone, 0);
  EXPECT_GT(near(), 1000);
  for (int i = 25; i < 35; ++i) gone += see(i).points_gone;
  EXPECT_GE(gone, 1);
  EXPECT_LT(near(), 50);
}

}  // namespace
}  // namespace rgbd_slam
