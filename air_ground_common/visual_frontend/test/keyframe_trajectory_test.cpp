#include "visual_frontend/keyframe_trajectory.h"

#include <gtest/gtest.h>

#include <cmath>

namespace visual_frontend {
namespace {

using air_ground_common::yawPose;

template <class StoredPose>
struct Drive {
  Drive() {
    for (int i = 0; i < 2; ++i) {
      Keyframe keyframe;
      keyframe.T_map_camera = yawPose(0.4 * i, {1.0 * i, 2, 3});
      map.addKeyframe(keyframe);
    }
  }
  Map map;
  KeyframeTrajectory<StoredPose> frames;
};

template <class StoredPose>
class KeyframeTrajectoryTest : public testing::Test {};
using StoredPoses = testing::Types<Pose, CompactPose>;
TYPED_TEST_SUITE(KeyframeTrajectoryTest, StoredPoses);

TYPED_TEST(KeyframeTrajectoryTest, FramesStayWhenTheirKeyframeGoes) {
  Drive<TypeParam> drive;
  const Pose first = yawPose(0.1, {0.5, 2, 3}), last = yawPose(0.3, {0.9, 2.1, 3});
  drive.frames.add(1, first, 1, drive.map);
  drive.frames.add(2, last, 1, drive.map);
  drive.frames.rebase(1, 0, drive.map);
  drive.map.removeKeyframe(1);
  EXPECT_EQ(drive.frames.lastReference(), 0);
  EXPECT_TRUE(drive.frames.pose(0, drive.map).isApprox(first, 1e-6));
  EXPECT_TRUE(drive.frames.lastPose(drive.map).isApprox(last, 1e-12));  // whole, however frames are stored
}

TYPED_TEST(KeyframeTrajectoryTest, FramesMoveWithTheMap) {
  Drive<TypeParam> drive;
  drive.frames.add(1, yawPose(0.1, {0.5, 2, 3}), 0, drive.map);
  drive.frames.add(2, yawPose(0.3, {0.9, 2.1, 3}), 1, drive.map);
  const auto before = drive.frames.poses(drive.map);
  const Eigen::Matrix3d R = air_ground_common::expSO3({0.1, -0.2, 0.5});
  const air_ground_common::Similarity S{2.5, R, Eigen::Vector3d(1, -1, 4)};
  drive.map.transform(S);
  drive.frames.rescale(S.scale);
  const auto after = drive.frames.poses(drive.map);
  ASSERT_EQ(after.size(), 2u);
  for (std::size_t i = 0; i < after.size(); ++i) {
    EXPECT_EQ(after[i].stamp, before[i].stamp);
    EXPECT_TRUE(after[i].T_map_body.translation().isApprox(S * before[i].T_map_body.translation(), 1e-6));
    EXPECT_TRUE(after[i].T_map_body.linear().isApprox(R * before[i].T_map_body.linear(), 1e-6));
  }
  EXPECT_TRUE(drive.frames.lastPose(drive.map).isApprox(after[1].T_map_body, 1e-6));
}

/// Along x, a keyframe each second, the frames between by the one before.
template <class StoredPose>
struct Line {
  explicit Line(bool added_as_keyframes) {
    for (int i = 0; i <= 8; ++i) {
      const double t = 0.25 * i;
      const Pose T = yawPose(0, {t, 0, 0});
      const bool keyframe = i % 4 == 0;
      if (keyframe && (i == 0 || added_as_keyframes)) frames.add(t, T, addKeyframe(t), map);
      if (keyframe && (i == 0 || added_as_keyframes)) continue;
      frames.add(t, T, map.lastKeyframe(), map);
      if (keyframe) frames.lastIsKeyframe(addKeyframe(t));
    }
  }
  KeyframeId addKeyframe(double t) {
    Keyframe keyframe;
    keyframe.stamp = t;
    keyframe.T_map_camera = yawPose(0, {t, 0, 0});
    return map.addKeyframe(keyframe);
  }
  double x(std::size_t i) const { return frames.pose(i, map).translation().x(); }

  Map map;
  KeyframeTrajectory<StoredPose> frames;
};

TYPED_TEST(KeyframeTrajectoryTest, FramesBetweenTwoKeyframesFollowBoth) {
  for (const bool added_as_keyframes : {true, false}) {
    Line<TypeParam> line(added_as_keyframes);
    for (std::size_t i = 0; i < 9; ++i) EXPECT_NEAR(line.x(i), 0.25 * static_cast<double>(i), 1e-6);
    // The first stretch was taken for half as long as it is.
    line.map.keyframe(1).T_map_camera = yawPose(0.4, {2, 0, 0});
    line.map.keyframe(2).T_map_camera = yawPose(0.4, {2 + std::cos(0.4), std::sin(0.4), 0});
    for (std::size_t i = 0; i < 4; ++i) EXPECT_LT(line.x(i + 1) - line.x(i), 0.75) << "a leap";
    EXPECT_NEAR(air_ground_common::yawOf(line.frames.pose(2, line.map).linear()), 0.2, 1e-6);
    EXPECT_TRUE(
        line.frames.pose(6, line.map).isApprox(yawPose(0.4, {2 + 0.5 * std::cos(0.4), 0.5 * std::sin(0.4), 0}), 1e-6));
    const auto before = line.frames.poses(line.map);
    line.frames.rebase(1, 0, line.map);
    line.map.removeKeyframe(1);
    const auto after = line.frames.poses(line.map);
    for (std::size_t i = 0; i < 9; ++i) EXPECT_TRUE(after[i].T_map_body.isApprox(before[i].T_map_body, 1e-6)) << i;
  }
}

TYPED_TEST(KeyframeTrajectoryTest, AChangeOfScaleBetweenTwoKeyframesBendsNothing) {
  Line<TypeParam> line(false);
  line.map.keyframe(1).T_map_camera.translation().x() = 1.5;
  line.map.keyframe(2).T_map_camera.translation().x() = 2.5;
  for (std::size_t i = 0; i <= 4; ++i) EXPECT_NEAR(line.x(i), 1.5 * 0.25 * static_cast<double>(i), 1e-6);
  // In another unit, too.
  line.map.transform({2, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()});
  line.frames.rescale(2);
  for (std::size_t i = 0; i <= 4; ++i) EXPECT_NEAR(line.x(i), 3 * 0.25 * static_cast<double>(i), 1e-6);
}

TYPED_TEST(KeyframeTrajectoryTest, TheImageOfAKeyframeIsWhereThatIsHoweverItWasPlaced) {
  Drive<TypeParam> drive;
  const Pose placed = yawPose(0.5, {1.1, 2, 3});
  drive.frames.add(1, placed, 1, drive.map);
  drive.frames.lastIsKeyframe(1);
  EXPECT_TRUE(drive.frames.pose(0, drive.map).isApprox(drive.map.keyframe(1).T_map_camera, 1e-6));
  EXPECT_TRUE(drive.frames.lastPose(drive.map).isApprox(placed, 1e-12)) << "what the next image moved from";
  // The landmarks that placed it place the next ones with the same error.
  const Pose step = yawPose(0.1, {0.2, 0, 0});
  drive.frames.add(2, placed * step, 1, drive.map);
  EXPECT_TRUE(drive.frames.lastPose(drive.map).isApprox(placed * step, 1e-12));
  EXPECT_TRUE(drive.frames.pose(1, drive.map).isApprox(drive.map.keyframe(1).T_map_camera * step, 1e-6));
  Keyframe next;
  next.stamp = 3;
  next.T_map_camera = placed * step * step;
  drive.frames.add(3, next.T_map_camera, 1, drive.map);
  drive.frames.lastIsKeyframe(drive.map.addKeyframe(next));
  // The adjustment moves it by that error.
  drive.map.keyframe(2).T_map_camera = drive.map.keyframe(1).T_map_camera * step * step;
  EXPECT_TRUE(drive.frames.pose(1, drive.map).isApprox(drive.map.keyframe(1).T_map_camera * step, 1e-6));
}

TYPED_TEST(KeyframeTrajectoryTest, AFrameThatBecomesAKeyframeIsWhereThatIs) {
  Drive<TypeParam> drive;
  drive.frames.add(1, yawPose(0.1, {0.5, 2, 3}), 0, drive.map);
  EXPECT_FALSE(drive.frames.isKeyframe(0));
  drive.frames.lastIsKeyframe(1);
  EXPECT_TRUE(drive.frames.isKeyframe(0));
  EXPECT_TRUE(drive.frames.lastPose(drive.map).isApprox(drive.map.keyframe(1).T_map_camera, 1e-12));
}

TYPED_TEST(KeyframeTrajectoryTest, VelocityComesFromTheNeighbours) {
  Drive<TypeParam> drive;
  for (int i = 0; i < 5; ++i) drive.frames.add(0.1 * i, yawPose(0.02 * i, {0.03 * i, 2, 3}), 0, drive.map);
  drive.frames.add(9, Pose::Identity(), 0, drive.map);
  const auto velocity = drive.frames.velocityAt(0.1 * 2, drive.map);
  ASSERT_TRUE(velocity);
  EXPECT_NEAR(velocity->angular.z(), 0.2, 1e-4);
  EXPECT_NEAR(velocity->linear.norm(), 0.3, 1e-4);
  EXPECT_FALSE(drive.frames.velocityAt(0.15, drive.map));  // no frame
  EXPECT_FALSE(drive.frames.velocityAt(9, drive.map));     // alone
}

TYPED_TEST(KeyframeTrajectoryTest, OldFramesAreThinned) {
  Drive<TypeParam> drive;
  for (int i = 0; i < 101; ++i) drive.frames.add(i, Pose::Identity(), 0, drive.map);
  drive.frames.thin(101);
  EXPECT_EQ(drive.frames.size(), 101u);
  drive.frames.thin(100);
  ASSERT_EQ(drive.frames.size(), 76u);  // 25 of 50, and the newer 51
  EXPECT_EQ(drive.frames.stamp(1), 2);
  EXPECT_EQ(drive.frames.stamp(25), 50);
  EXPECT_EQ(drive.frames.lastStamp(), 100);
}

}  // namespace
}  // namespace visual_frontend
