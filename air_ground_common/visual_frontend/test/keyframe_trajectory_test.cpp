#include "visual_frontend/keyframe_trajectory.h"

#include <gtest/gtest.h>

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
