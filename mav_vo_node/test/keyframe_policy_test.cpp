#include "../src/keyframe_policy.h"

#include <gtest/gtest.h>

namespace mav_vo {
namespace {

constexpr double kScene = 2;  // distance of the scene

Pose moved(double distance, double angle = 0) {
  Pose T = Pose::Identity();
  T.translation().y() = distance;
  T.linear() = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitX()).toRotationMatrix();
  return T;
}

struct Policy : ::testing::Test {
  Policy() {
    settings.keyframe_distance = 0.1;
    settings.keyframe_angle = 0.25;
    settings.keyframe_overlap = 0.65;
    settings.keyframe_max_interval = 1;
    last.stamp = 100;
  }
  bool due(double seconds, const Pose& T_map_camera, int landmarks = 1000) const {
    return policy.due(last, last.stamp + seconds, T_map_camera, kScene, landmarks);
  }

  OdometrySettings settings;
  visual_frontend::Keyframe last;
  KeyframePolicy policy{settings};
};

TEST_F(Policy, AnotherViewIsAKeyframe) {
  EXPECT_FALSE(due(0.05, moved(0.19)));
  EXPECT_TRUE(due(0.05, moved(0.21)));
  EXPECT_FALSE(due(0.05, moved(0, 0.24)));
  EXPECT_TRUE(due(0.05, moved(0, -0.26)));
}

TEST_F(Policy, LandmarksLostAreAKeyframe) {
  EXPECT_FALSE(due(0.05, moved(0), 1)) << "nothing is known of what the last one saw";
  policy.setLandmarks(100);
  EXPECT_FALSE(due(0.05, moved(0), 66));
  EXPECT_TRUE(due(0.05, moved(0), 64));
  policy.reset();
  EXPECT_FALSE(due(0.05, moved(0), 64));
}

TEST_F(Policy, InertialLinksOfAMovingVehicleStayShort) {
  EXPECT_FALSE(due(0.95, moved(0.05)));
  EXPECT_TRUE(due(1.05, moved(0.05)));
  EXPECT_FALSE(due(1.05, moved(0.01))) << "hovers";
}

TEST_F(Policy, HoveringVehicleGivesOneKeyframeAndThenFew) {
  EXPECT_FALSE(due(2.9, moved(0)));
  EXPECT_TRUE(due(3.1, moved(0)));
  policy.follow(last, moved(0.01, 0.05), kScene);
  EXPECT_TRUE(policy.hovering());
  EXPECT_FALSE(due(8.9, moved(0)));
  EXPECT_TRUE(due(9.1, moved(0)));
  EXPECT_TRUE(due(3.1, moved(0, 0.07))) << "it turns: the hover is over";
  policy.follow(last, moved(0.03), kScene);
  EXPECT_FALSE(policy.hovering());
  EXPECT_TRUE(due(3.1, moved(0)));
}

}  // namespace
}  // namespace mav_vo
