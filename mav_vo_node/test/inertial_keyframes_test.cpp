#include "../src/inertial_keyframes.h"

#include <gtest/gtest.h>

#include "synthetic_flight.h"

namespace mav_vo {
namespace {

using visual_frontend::Keyframe;
using visual_frontend::KeyframeId;

constexpr double kBegin = 4, kStep = 0.5;  // of the keyframes [s]

/// Keyframes of a flight where the camera was, and the motion that a perfect IMU felt between them.
struct Links : ::testing::Test {
  Links() {
    std::mt19937 random(1);
    ImuNoise none;
    none.gyro_density = none.accel_density = 0;
    for (const ImuSample& s : flight.imuSamples(kBegin - 0.1, kBegin + 2, 400, none, {}, random)) imu.add(s);
  }
  KeyframeId addKeyframe() {
    Keyframe keyframe;
    keyframe.stamp = kBegin + kStep * static_cast<double>(map.keyframeCount());
    keyframe.T_map_camera = flight.T_world_imu(keyframe.stamp) * synthetic::T_imu_camera();
    return map.addKeyframe(keyframe);
  }
  Preintegration motionTo(KeyframeId id) const {
    const double stamp = map.keyframe(id).stamp;
    Preintegration motion(ImuNoise{}, ImuBias{});
    motion.integrate(samplesBetween(imu, stamp - kStep, stamp));
    return motion;
  }
  /// `count` keyframes, each linked to the one before.
  void fly(int count) {
    for (int i = 0; i < count; ++i) {
      const KeyframeId id = addKeyframe();
      if (i == 0)
        keyframes.add(id, nullptr, std::nullopt, {}, Eigen::Vector3d::Zero());
      else
        keyframes.add(id, &map.keyframe(id - 1), motionTo(id), {}, Eigen::Vector3d::Zero());
    }
  }
  bool contradicts(const Keyframe& second, double gyro_bias_stddev = 0) const {
    return keyframes.contradicts(motionTo(1), map.keyframe(0), second, gyro_bias_stddev, 2);
  }
  double errorOfVelocity(KeyframeId id) const {
    return (keyframes.data().states.at(id).velocity - flight.velocity(map.keyframe(id).stamp)).norm();
  }

  synthetic::Flight flight;
  ImuBuffer imu{10};
  visual_frontend::Map map;
  InertialKeyframes keyframes{OdometrySettings{}, synthetic::T_imu_camera().inverse()};
};

TEST_F(Links, AMapThatBecomesMetricKnowsItsVelocities) {
  fly(3);
  EXPECT_EQ(keyframes.data().states.at(1).velocity, Eigen::Vector3d::Zero()) << "of a map without a unit";
  keyframes.makeMetric(map, {0, 0, 0});
  EXPECT_TRUE(keyframes.metric());
  for (KeyframeId id = 0; id < 3; ++id) EXPECT_LT(errorOfVelocity(id), 0.005) << id;
  // The next one goes on from there.
  const KeyframeId id = addKeyframe();
  keyframes.data().states.at(2).bias.gyro.x() = 1e-4;
  keyframes.add(id, &map.keyframe(2), motionTo(id), {}, Eigen::Vector3d(9, 9, 9));
  EXPECT_LT(errorOfVelocity(id), 0.005);
  EXPECT_EQ(keyframes.newestBias()->gyro.x(), 1e-4);
  keyframes.clear();
  EXPECT_FALSE(keyframes.metric());
  EXPECT_FALSE(keyframes.linked());
  EXPECT_EQ(keyframes.newestBias(), nullptr);
}

TEST_F(Links, WithoutALinkTheVelocityIsTheGivenOne) {
  fly(1);
  keyframes.makeMetric(map, {0, 0, 0});
  keyframes.add(addKeyframe(), &map.keyframe(0), std::nullopt, {{0.1, 0, 0}, {}}, {1, 2, 3});
  EXPECT_EQ(keyframes.data().states.at(1).velocity, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(keyframes.newestBias()->gyro.x(), 0.1);
  EXPECT_FALSE(keyframes.linked());
}

TEST_F(Links, ATurnThatTheGyroDidNotFeelIsNoLink) {
  fly(2);
  EXPECT_FALSE(contradicts(map.keyframe(1)));
  for (const double side : {-1, 1}) {
    Keyframe turned = map.keyframe(1);
    turned.T_map_camera.linear() *= Eigen::AngleAxisd(0.1 * side, Eigen::Vector3d::UnitX()).toRotationMatrix();
    EXPECT_TRUE(contradicts(turned));
    EXPECT_FALSE(contradicts(turned, 0.1)) << "the gyro may be off by as much";
  }
}

TEST_F(Links, AWayThatTheAccelerometerDidNotFeelIsNoLinkOfAMetricMap) {
  fly(2);
  Keyframe carried = map.keyframe(1), near = carried;
  carried.T_map_camera.translation() += Eigen::Vector3d(0.4, 0, 0);
  near.T_map_camera.translation() += Eigen::Vector3d(0.02, 0, 0);
  EXPECT_FALSE(contradicts(carried)) << "the map's unit is not known";
  keyframes.makeMetric(map, {0, 0, 0});
  EXPECT_TRUE(contradicts(carried));
  EXPECT_FALSE(contradicts(near));
  EXPECT_FALSE(contradicts(map.keyframe(1)));
}

TEST_F(Links, AKeyframeThatGoesTakesBothLinksWithIt) {
  fly(4);
  keyframes.remove(1, map);
  map.removeKeyframe(1);
  EXPECT_EQ(keyframes.data().states.size(), 3u);
  ASSERT_EQ(keyframes.data().links.size(), 1u);
  EXPECT_EQ(keyframes.data().links.begin()->first, 3);
  keyframes.forgetLinksBefore(3);
  EXPECT_TRUE(keyframes.linked());
  keyframes.forgetLinksBefore(4);
  EXPECT_FALSE(keyframes.linked());
}

TEST_F(Links, LinksAreIntegratedAnewFromKeyframeToKeyframe) {
  fly(3);
  std::vector<std::pair<double, double>> asked;
  keyframes.integrateAnew(map, [&](double from, double to, const ImuBias& bias) -> std::optional<Preintegration> {
    asked.emplace_back(from, to);
    if (asked.size() > 1) return std::nullopt;  // its samples are gone
    Preintegration motion(ImuNoise{}, bias);
    motion.integrate(samplesBetween(imu, from, from + 0.25));
    return motion;
  });
  const std::vector<std::pair<double, double>> expected{{kBegin, kBegin + kStep}, {kBegin + kStep, kBegin + 2 * kStep}};
  EXPECT_EQ(asked, expected);
  EXPECT_NEAR(keyframes.data().links.at(1).duration(), 0.25, 1e-9);
  EXPECT_NEAR(keyframes.data().links.at(2).duration(), kStep, 1e-9);
}

// What the accelerometer read of gravity stays explained; turns are about the turned axes.
TEST_F(Links, OtherAxesOfTheImuLeaveWhatItReadsExplained) {
  fly(3);
  const Eigen::Matrix3d R = air_ground_common::expSO3({0.05, -0.03, 0.02});
  keyframes.data().states.at(1).bias.gyro = {0.01, 0, 0};
  const auto velocity = [&] { return keyframes.data().links.at(2).velocity(keyframes.data().states.at(1).bias); };
  const Eigen::Matrix3d turn = keyframes.data().links.at(2).rotation();
  const Eigen::Vector3d before = velocity();
  keyframes.turn(R, map);
  EXPECT_LT((velocity() - before).norm(), 0.06) << "0.3 m/s by the turn of gravity alone";
  EXPECT_LT((keyframes.newestBias()->accel).norm(), 0.7);
  EXPECT_GT((keyframes.newestBias()->accel).norm(), 0.4);
  EXPECT_LT(air_ground_common::rotationAngle(keyframes.data().links.at(2).rotation(), R * turn * R.transpose()), 1e-6);
  EXPECT_LT((keyframes.data().states.at(1).bias.gyro - R.col(0) * 0.01).norm(), 1e-12);
}

}  // namespace
}  // namespace mav_vo
