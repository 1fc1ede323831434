// What readings are of use for: heights of GPS where the difference to the map's heights is known, magnetic headings
// where the declination is.
#include "../src/ros/sensor_bridge.h"

#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

namespace ekf_tracker {
namespace {

const air_ground_common::LocalFrame& berlin() {
  static const air_ground_common::LocalFrame frame("EPSG:25833", {392000, 5820000, 35});
  return frame;
}

// 39 m of undulation in Berlin: what a receiver says 10 m above the origin, 12 m east and 5 m north of it.
sensor_msgs::NavSatFix fixInBerlin(double stamp) {
  const auto place = berlin().toGeodetic({12, 5, 10});
  sensor_msgs::NavSatFix msg;
  msg.header.stamp.fromSec(stamp);
  msg.latitude = place.latitude;
  msg.longitude = place.longitude;
  msg.altitude = place.height + 39;
  msg.status.status = sensor_msgs::NavSatStatus::STATUS_FIX;
  return msg;
}

NodeSettings settingsWith(std::optional<double> undulation) {
  NodeSettings settings;
  settings.geoid_undulation = undulation;
  return settings;
}

// At the origin, 10 m high, and then ten seconds without odometry.
PoseFilter afterAGap() {
  FilterSettings settings;
  PoseFilter filter(settings);
  Measurement fix;
  fix.value << 0, 0, 10, 0;
  fix.covariance = Vector4d(0.04, 0.04, 0.04, 1e-4).asDiagonal();
  for (int i = 0; i < 3; ++i) filter.correct(fix);
  Increment gap;
  gap.gap = true;
  gap.stamp = 10;
  gap.covariance = Vector4d(225, 225, 225, 1).asDiagonal();
  filter.predict(gap);
  return filter;
}

TEST(SensorBridge, AFixTellsTheVerticalAsWellAsItStates) {
  geometry_msgs::PoseWithCovarianceStamped msg;
  msg.header.stamp.fromSec(5);
  msg.pose.pose.orientation.y = std::sin(0.1);  // nose down by 0.2 rad
  msg.pose.pose.orientation.w = std::cos(0.1);
  EXPECT_FALSE(SensorBridge::vertical(msg)) << "states nothing";
  msg.pose.covariance[21] = 4e-4, msg.pose.covariance[28] = 9e-4;
  const auto vertical = SensorBridge::vertical(msg);
  ASSERT_TRUE(vertical);
  EXPECT_EQ(vertical->stamp, 5);
  EXPECT_NEAR(vertical->stddev, 0.03, 1e-9);
  EXPECT_LT((vertical->up_body - Eigen::Vector3d(-std::sin(0.2), 0, std::cos(0.2))).norm(), 1e-9);
  msg.pose.covariance[28] = 4e-4, msg.pose.covariance[22] = msg.pose.covariance[27] = 3e-4;
  EXPECT_NEAR(SensorBridge::vertical(msg)->stddev, std::sqrt(7e-4), 1e-9) << "the worst direction";
  msg.pose.covariance[28] = 0.04;
  EXPECT_FALSE(SensorBridge::vertical(msg)) << "hardly known";
  msg.pose.covariance[28] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(SensorBridge::vertical(msg));
}

TEST(SensorBridge, AnIncrementKnowsHowWellItIsLevelled) {
  air_ground::VoIncrement msg;
  msg.header.stamp.fromSec(1);
  msg.relative_pose.position.x = 1;
  msg.relative_pose.orientation.w = 1;
  const Tilt tilt{Eigen::AngleAxisd(-0.2, Eigen::Vector3d::UnitY()).toRotationMatrix(), 0.02};  // nose up
  for (const bool body : {true, false}) {
    NodeSettings settings;
    settings.level_increments = body;
    const Increment increment = SensorBridge(settings, nullptr).increment(msg, tilt);
    EXPECT_EQ(increment.tilt_stddev, body ? 0.02 : 0);
    EXPECT_NEAR(increment.motion.z(), body ? std::sin(0.2) : 0, 1e-9);
  }
}

TEST(SensorBridge, WithoutUndulationGpsTellsThePlanAlone) {
  const NodeSettings unknown = settingsWith(std::nullopt);
  SensorBridge bridge(unknown, &berlin());
  const auto plan = bridge.gps(fixInBerlin(100));
  ASSERT_TRUE(plan);
  EXPECT_EQ(plan->size(), 2);
  EXPECT_LT((plan->value.head<2>() - Eigen::Vector2d(12, 5)).norm(), 1e-3);
  PoseFilter filter = afterAGap();
  const Outcome out = filter.correct(*plan);
  EXPECT_EQ(out.result, Result::kFused);
  EXPECT_EQ(out.dof, 2);
  EXPECT_NEAR(out.gate, 11.83, 0.01);
  EXPECT_NEAR(filter.state().x[2], 10, 1e-9);
  EXPECT_GT(filter.state().covariance(2, 2), 225);
  EXPECT_NEAR(filter.state().x[0], 12 * 225.04 / (225.04 + 64), 0.1);
  EXPECT_NEAR(filter.state().x[1], 5 * 225.04 / (225.04 + 64), 0.1);

  // As if both datums were one: 39 m pass the gate, and half of them go into the height.
  const NodeSettings none = settingsWith(0);
  PoseFilter misled = afterAGap();
  EXPECT_EQ(misled.correct(*SensorBridge(none, &berlin()).gps(fixInBerlin(100))).result, Result::kFused);
  EXPECT_GT(misled.state().x[2], 25);
}

TEST(SensorBridge, WithUndulationGpsTellsTheHeight) {
  const NodeSettings known = settingsWith(39);
  const auto m = SensorBridge(known, &berlin()).gps(fixInBerlin(100));
  ASSERT_TRUE(m);
  EXPECT_EQ(m->size(), 3);
  EXPECT_LT((m->value.head<3>() - Eigen::Vector3d(12, 5, 10)).norm(), 1e-3);
}

// Receivers that see three satellites give none.
TEST(SensorBridge, PlanNeedsNoHeight) {
  for (const auto& undulation : {std::optional<double>(), std::optional<double>(39)}) {
    const NodeSettings settings = settingsWith(undulation);
    sensor_msgs::NavSatFix msg = fixInBerlin(100);
    msg.altitude = std::numeric_limits<double>::quiet_NaN();
    const auto m = SensorBridge(settings, &berlin()).gps(msg);
    ASSERT_TRUE(m);
    EXPECT_TRUE(m->plan_only);
    EXPECT_TRUE(m->value.allFinite());
  }
}

TEST(SensorBridge, MagneticHeadingNeedsTheDeclination) {
  sensor_msgs::MagneticField msg;
  msg.magnetic_field.x = 20e-6, msg.magnetic_field.z = -40e-6;  // the body looks to magnetic north
  const Eigen::Matrix3d level = Eigen::Matrix3d::Identity();
  NodeSettings settings;
  EXPECT_THROW(SensorBridge(settings, nullptr).heading(msg, level, level), std::invalid_argument);
  settings.declination = 0.2;
  EXPECT_NEAR(SensorBridge(settings, nullptr).heading(msg, level, level).value[0], M_PI / 2 - 0.2, 1e-12);
}

}  // namespace
}  // namespace ekf_tracker
