// Scale and vertical taken over from an alignment, against a known similarity.
#include "mav_vo/external_scale.h"

#include <gtest/gtest.h>

#include <cmath>

namespace mav_vo {
namespace {

using air_ground_common::expSO3;
using air_ground_common::Similarity;

constexpr double kUnit = 2.7;  // [m] a length of 1 in the visual map

/// base_link of a MAV that flies in a metric, level world, and the visual map of its camera: the world tilted, turned,
/// shifted, and divided by kUnit.
struct Flight {
  Pose T_base_camera = Pose::Identity();
  Similarity T_visual_world;
  Flight() {
    T_base_camera.linear() = Eigen::Vector3d(1, -1, -1).asDiagonal();
    T_base_camera.translation() << 0.1, -0.05, 0.03;
    T_visual_world = {1 / kUnit, expSO3({0.1, -0.2, 0.7}), {0.4, -0.3, 0.2}};
  }
  Pose world(double t) const {
    Pose T = Pose::Identity();
    T.linear() = expSO3({0.05 * std::sin(t), 0.02 * t, 0.3 * t});
    T.translation() << t, 0.5 * std::sin(t), 1.5 + 0.1 * t;
    return T;
  }
  Pose visual(double t) const {  // of the camera
    const Pose T = world(t) * T_base_camera;
    Pose out = Pose::Identity();
    out.linear() = T_visual_world.R * T.linear();
    out.translation() = T_visual_world * T.translation();
    return out;
  }
  /// As an alignment with a ground map that is turned by `yaw` and shifted against the world gives it.
  AlignedScale aligned(double scale_error = 0, double stddev = 0.01, std::uint32_t map_id = 4) const {
    const Eigen::Matrix3d R_ground_world = expSO3({0, 0, 1.2});
    AlignedScale o;
    o.map_id = map_id;
    o.T_ground_visual.scale = kUnit * (1 + scale_error);
    o.T_ground_visual.R = R_ground_world * T_visual_world.R.transpose();
    o.T_ground_visual.t = Eigen::Vector3d(3, 4, 0.1);  // has no part in scale and vertical
    o.scale_stddev = stddev;
    o.tilt_stddev = 0.002;
    o.T_visual_camera_first = visual(0);
    return o;
  }
  VoResult result(double t) const {
    VoResult r;
    r.map_id = 4;
    r.state = OdometryState::kScaling;
    r.reason = "no IMU";
    r.pose_valid = true;
    r.T_map_camera = visual(t);
    r.camera_covariance = 1e-6 * Matrix6d::Identity();
    r.depth_min = 0.5;
    r.depth_max = 2;
    Increment step;
    Pose T = visual(t - 0.1).inverse() * visual(t);
    step.T_previous_current = T_base_camera * T * T_base_camera.inverse();
    step.covariance = step.pose_covariance = 1e-6 * Eigen::Matrix4d::Identity();
    r.increment = step;
    return r;
  }
};

TEST(ExternalScale, LengthsAndVerticalAreTheWorlds) {
  const Flight flight;
  ExternalScale scale(flight.T_base_camera);
  EXPECT_FALSE(scale.metric(flight.result(1)).metric);
  ASSERT_TRUE(scale.update(flight.aligned()));
  // Origin and heading are those of base_link at the first keyframe.
  const Pose first = flight.world(0);
  const Pose T_map_world = air_ground_common::yawPose(-air_ground_common::yawOf(first.linear()), {0, 0, 0}) *
                           Pose(Eigen::Translation3d(-first.translation()));
  for (const double t : {0.5, 1.0, 3.0}) {
    const VoResult r = scale.metric(flight.result(t));
    EXPECT_TRUE(r.metric);
    EXPECT_EQ(r.state, OdometryState::kTracking);
    EXPECT_EQ(r.reason, "scale from the ground map");
    EXPECT_LT((r.T_map_base.matrix() - (T_map_world * flight.world(t)).matrix()).norm(), 1e-9) << t;
    EXPECT_LT((r.increment->T_previous_current.matrix() - (flight.world(t - 0.1).inverse() * flight.world(t)).matrix())
                  .norm(),
              1e-9);
    EXPECT_NEAR(r.increment->covariance(0, 0), kUnit * kUnit * 1e-6, 1e-12);
    EXPECT_NEAR(r.increment->covariance(3, 3), 1e-6, 1e-12);
    EXPECT_NEAR(r.depth_max, 2 * kUnit, 1e-12);
    EXPECT_NEAR(r.scale, kUnit, 1e-12);
    // Half a per cent of the way from the origin comes from the scale's 1 per cent, and the rest from the image.
    EXPECT_GT(std::sqrt(r.covariance(0, 0)), 0.009 * std::abs(r.T_map_camera.translation().x()));
  }
  air_ground_common::Trajectory track{{0.0, flight.visual(0)}, {2.0, flight.visual(2)}};
  const auto metric = scale.metric(track, 4);
  EXPECT_NEAR(
      (metric[1].T_map_body.translation() - metric[0].T_map_body.translation()).norm(),
      ((flight.world(2) * flight.T_base_camera).translation() - (first * flight.T_base_camera).translation()).norm(),
      1e-9);
}

TEST(ExternalScale, SmallAndSingleChangesDoNotMoveIt) {
  const Flight flight;
  ExternalScale scale(flight.T_base_camera);
  ASSERT_TRUE(scale.update(flight.aligned()));
  EXPECT_FALSE(scale.update(flight.aligned(0.02))) << "within two standard deviations of both";
  EXPECT_FALSE(scale.update(flight.aligned(0.08))) << "not confirmed";
  EXPECT_FALSE(scale.update(flight.aligned(0.0)));
  EXPECT_FALSE(scale.update(flight.aligned(0.08))) << "the one between spoke against it";
  EXPECT_TRUE(scale.update(flight.aligned(0.07)));
  EXPECT_NEAR(scale.T_map_visual(4)->scale, 1.07 * kUnit, 1e-12);
}

TEST(ExternalScale, AnotherMapHasNoneYet) {
  const Flight flight;
  ExternalScale scale(flight.T_base_camera);
  EXPECT_FALSE(scale.update(flight.aligned(0, 0.3))) << "too uncertain";
  EXPECT_FALSE(scale.update(flight.aligned(0, 0))) << "nothing is known of it";
  ASSERT_TRUE(scale.update(flight.aligned()));
  VoResult r = flight.result(1);
  r.map_id = 5;
  EXPECT_FALSE(scale.metric(r).metric);
  ASSERT_TRUE(scale.update(flight.aligned(0, 0.01, 5)));
  EXPECT_TRUE(scale.metric(r).metric);
  EXPECT_FALSE(scale.T_map_visual(4));
}

}  // namespace
}  // namespace mav_vo
