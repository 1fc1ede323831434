// CameraMotion and MapLevel, against the motion and the lean that made the samples.
#include <gtest/gtest.h>

#include "../src/camera_motion.h"
#include "../src/map_level.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using air_ground_common::expSO3;
using air_ground_common::rotationAngle;
using simulated::Robot;
using simulated::synthetic::Random;
using visual_frontend::ImuSample;

const Eigen::Vector3d kRate(0.3, -0.2, 0.5);  // of the base, own axes [rad/s]

/// Feeds an IMU that turns steadily, without noise, from 0 to `end` [s].
void turn(CameraMotion& motion, const Mounting& mounting, const Eigen::Vector3d& rate, double end) {
  for (int i = 0; i <= 200 * end; ++i)
    motion.addImu({0.005 * i, mounting.R_base_imu->transpose() * rate, {0, 0, visual_frontend::kGravity}});
}

/// How a camera on a base that turns by `angles` about its own axes turns in its own.
Eigen::Matrix3d cameraTurn(const Mounting& mounting, const Eigen::Vector3d& angles) {
  const Eigen::Matrix3d R_camera_base = mounting.T_base_camera.linear().transpose();
  return expSO3(Eigen::Vector3d(R_camera_base * angles));
}

TEST(CameraMotion, TheGyroPredictsTheTurnAndTheLastStepTheWay) {
  const Robot robot;
  CameraMotion motion(robot.camera, robot.mounting, {});
  turn(motion, robot.mounting, kRate, 1);
  const Pose before = robot.base(3) * robot.mounting.T_base_camera;
  Pose now = before;
  now.translation() += Eigen::Vector3d(0.03, 0.01, -0.02);
  motion.update(0.1, before, now);
  bool from_gyro = false;
  const Pose predicted = motion.predict(0.5, now, 0.6, &from_gyro);
  EXPECT_TRUE(from_gyro);
  EXPECT_LT(rotationAngle(predicted.linear(), now.linear() * cameraTurn(robot.mounting, 0.1 * kRate)), 1e-6);
  EXPECT_LT((predicted.translation() - now.translation() - Eigen::Vector3d(0.03, 0.01, -0.02)).norm(), 1e-9);
  EXPECT_LT((*motion.feltTurn(0.2, 0.6) - 0.4 * kRate).norm(), 1e-6);
  EXPECT_FALSE(motion.feltTurn(0.6, 1.6)) << "there are no samples";
}

TEST(CameraMotion, WithoutAGyroTheLastTurnGoesOn) {
  Robot robot;
  CameraMotion motion(robot.camera, robot.mounting, {});
  turn(motion, robot.mounting, kRate, 2);
  const Pose before = robot.mounting.T_base_camera;
  const Eigen::Matrix3d step = expSO3({0.01, 0.03, -0.02});
  const Pose now = before * Pose(step);
  motion.update(0.1, before, now);
  motion.trustGyro(false);
  EXPECT_FALSE(motion.gyroTrusted());
  bool from_gyro = true;
  EXPECT_LT(rotationAngle(motion.predict(0.5, now, 0.6, &from_gyro).linear(), now.linear() * step), 1e-6);
  EXPECT_FALSE(from_gyro);
  EXPECT_EQ(motion.predict(0.5, now, 1.5, &from_gyro).matrix(), now.matrix()) << "who knows, after a second";
  motion.interrupt();
  EXPECT_EQ(motion.predict(0.5, now, 0.6, &from_gyro).matrix(), now.matrix());
  EXPECT_TRUE(motion.feltTurn(0.2, 0.6)) << "it is still compared";
  robot.mounting.R_base_imu.reset();
  CameraMotion blind(robot.camera, robot.mounting, {});
  EXPECT_FALSE(blind.addImu({}));
  EXPECT_FALSE(blind.feltTurn(0.2, 0.6));
}

TEST(CameraMotion, SamplesAreOfTheCamerasClock) {
  const Robot robot;
  SlamSettings settings;
  settings.time_offset = 0.25;  // stamps are so late
  CameraMotion motion(robot.camera, robot.mounting, settings);
  turn(motion, robot.mounting, kRate, 1);
  EXPECT_TRUE(motion.feltTurn(-0.2, 0.7));
  EXPECT_FALSE(motion.feltTurn(0.7, 0.95));
}

TEST(CameraMotion, TurnsWithTheMap) {
  const Robot robot;
  CameraMotion motion(robot.camera, robot.mounting, {});
  Pose now = Pose::Identity();
  now.translation().x() = 0.1;
  motion.update(0.1, Pose::Identity(), now);
  motion.turn(expSO3({0, 0, M_PI / 2}));
  bool from_gyro = false;
  const Eigen::Vector3d way = motion.predict(0, Pose::Identity(), 0.1, &from_gyro).translation();
  EXPECT_LT((way - Eigen::Vector3d(0, 0.1, 0)).norm(), 1e-9);
}

TEST(CameraMotion, ARestTellsTheGyrosBias) {
  const Robot robot;
  CameraMotion motion(robot.camera, robot.mounting, {});
  const Eigen::Vector3d bias(0.01, -0.02, 0.015);
  turn(motion, robot.mounting, bias, 1);
  EXPECT_EQ(motion.gyroBias(), Eigen::Vector3d::Zero());
  const double before = motion.rotationSigma(0.1);
  motion.startMap();
  EXPECT_LT((*robot.mounting.R_base_imu * motion.gyroBias() - bias).norm(), 1e-6);
  EXPECT_LT(motion.rotationSigma(0.1), 0.5 * before);
  bool from_gyro = false;
  const Pose T = robot.mounting.T_base_camera;
  EXPECT_LT(rotationAngle(motion.predict(0.5, T, 1, &from_gyro).linear(), T.linear()), 1e-6);
  motion.reset();
  EXPECT_EQ(motion.gyroBias(), Eigen::Vector3d::Zero());
  EXPECT_FALSE(motion.attitude().initialized());
}

TEST(CameraMotion, RowsMoveAsTheGyroFeelsIt) {
  const Robot robot;
  SlamSettings settings;
  settings.readout_time = 0.03;
  CameraMotion motion(robot.camera, robot.mounting, settings);
  turn(motion, robot.mounting, kRate, 1);
  motion.setRowMotion(0.5, Pose::Identity());
  // Half a readout after the middle row, a far point is seen by a camera that has turned on.
  const double row = robot.camera.height - 0.5;
  const Eigen::Vector3d p(1, 2, 30), seen = cameraTurn(robot.mounting, 0.015 * kRate).transpose() * p;
  EXPECT_LT((motion.rows().pointToMiddleRow(row, seen) - p).norm(), 1e-4);
}

/// A base at rest that leans against a map that was begun by the specific force of a curve.
struct Level : ::testing::Test {
  Level() {
    robot.mounting.T_base_camera.translation().setZero();
    lean = expSO3({0.06, -0.08, 0});
  }
  /// Samples of a rest, the map's base upright in the world.
  void rest(double from, double to) {
    for (double t = from; t <= to; t += 0.005)
      motion.addImu({t, Eigen::Vector3d::Zero(), {0, 0, visual_frontend::kGravity}});
  }
  /// The base in a map that leans: its pose there if it stands upright, facing along `yaw`.
  Pose baseInMap(double yaw) const { return Pose(lean * expSO3({0, 0, yaw})); }
  std::optional<MapLevel::Correction> update(double yaw = 1) {
    return level.update(1.5, motion, baseInMap(yaw) * robot.mounting.T_base_camera, baseInMap(0.3));
  }

  Robot robot;
  SlamSettings settings;
  CameraMotion motion{robot.camera, robot.mounting, settings};
  MapLevel level{settings};
  Eigen::Matrix3d lean;  // R_map_world
};

TEST_F(Level, ARestLevelsAMapThatWasBegunInMotion) {
  rest(0, 0.2);  // too short to be known as one
  level.begin(&motion.attitude());
  EXPECT_TRUE(level.known());
  EXPECT_FALSE(level.settled());
  EXPECT_GT(level.sigma(), 0.05);
  EXPECT_FALSE(update()) << "nothing is known better";
  rest(0.205, 1.5);
  const auto correction = update();
  ASSERT_TRUE(correction);
  EXPECT_TRUE(correction->directions_false);
  EXPECT_LT((correction->R * lean * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitZ()).norm(), 1e-6);
  EXPECT_NEAR(air_ground_common::yawOf(correction->R * baseInMap(0.3).linear()), 0, 1e-9);
  EXPECT_LT((level.vertical().up - Eigen::Vector3d::UnitZ()).norm(), 1e-9);
  EXPECT_TRUE(level.settled());
  EXPECT_NEAR(level.sigma(), motion.attitude().upSigma(), 1e-9);
  lean = Eigen::Matrix3d(correction->R * lean);
  EXPECT_FALSE(update()) << "once is enough";
}

TEST_F(Level, ALittleLeanIsLeftAndCountsAsUncertainty) {
  lean = expSO3({0.004, 0, 0});
  rest(0, 0.2);
  level.begin(&motion.attitude());
  rest(0.205, 1.5);
  EXPECT_FALSE(update());
  EXPECT_TRUE(level.settled());
  EXPECT_NEAR(level.sigma(), std::hypot(motion.attitude().upSigma(), 0.004), 1e-6);
  EXPECT_NEAR(level.vertical().up.y(), -0.004, 1e-6);
}

TEST_F(Level, BegunAtRestItStays) {
  rest(0, 1);
  level.begin(&motion.attitude());
  EXPECT_TRUE(level.settled());
  EXPECT_FALSE(update());
  // Up in a camera that looks forward and down, as the accelerometer has it.
  const auto up = level.upInCamera(1, Eigen::Matrix3d::Identity(), motion);
  ASSERT_TRUE(up);
  EXPECT_LT((robot.mounting.T_base_camera.linear() * up->first - Eigen::Vector3d::UnitZ()).norm(), 1e-6);
  EXPECT_NEAR(up->second, 1.5 * motion.attitude().upSigma(), 1e-9);
}

TEST_F(Level, WithoutAnAccelerometerThatIsRightNothingIsUp) {
  level.begin(nullptr);
  EXPECT_FALSE(level.known());
  EXPECT_TRUE(level.settled());
  rest(0, 1);
  EXPECT_FALSE(update());
  level.clear();
  level.begin(&motion.attitude());
  ASSERT_TRUE(level.upInCamera(1, Eigen::Matrix3d::Identity(), motion));
  EXPECT_LT(level.sigma(), 0.02);
  level.distrust(Pose(expSO3({0, 0, 0.7}) * expSO3({0.3, 0, 0})));
  EXPECT_FALSE(level.known());
  EXPECT_FALSE(level.upInCamera(1, Eigen::Matrix3d::Identity(), motion));
  EXPECT_NEAR(level.sigma(), std::hypot(0.05, 0.3), 1e-9) << "the base may be level, and the map leans against it";
  EXPECT_EQ(level.vertical().stddev, level.sigma());
  level.distrust(Pose(expSO3({0.6, 0, 0})));
  EXPECT_NEAR(level.sigma(), std::hypot(0.05, 0.3), 1e-9) << "once";
}

TEST_F(Level, AnImuThatHasFallenSilentTellsNothing) {
  rest(0, 1);
  level.begin(&motion.attitude());
  EXPECT_TRUE(level.upInCamera(1.4, Eigen::Matrix3d::Identity(), motion));
  EXPECT_FALSE(level.upInCamera(1.6, Eigen::Matrix3d::Identity(), motion));
}

TEST(MapLevel, TheMotionThatCameraAndImuAgreeOnTellsUp) {
  Robot robot;
  robot.rest = 0;
  robot.sway = 0.15;
  SlamSettings settings;
  CameraMotion motion(robot.camera, robot.mounting, settings);
  MapLevel level(settings);
  Random random(5);
  const Eigen::Matrix3d lean = expSO3({0.05, 0.03, 0});  // R_map_world
  const auto cameraAt = [&](double t) { return Pose(Pose(lean) * robot.base(t) * robot.mounting.T_base_camera); };
  double next = 0.5;
  bool corrected = false;
  for (double t = 1; t < 16 && !corrected; t += 0.1) {
    for (; next <= t + 0.005; next += 0.005) motion.addImu(robot.imu(next, random));
    if (t == 1) level.begin(&motion.attitude());
    motion.addPose(t, cameraAt(t), 1e-8 * Matrix6d::Identity());
    const auto correction = level.update(t, motion, cameraAt(t), Pose(lean) * robot.base(1));
    if (!correction) continue;
    corrected = true;
    EXPECT_LT((correction->R * lean * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitZ()).norm(), 0.03) << t;
    EXPECT_NEAR(air_ground_common::yawOf(correction->R * lean * robot.base(1).linear()), 0, 1e-9);
    EXPECT_LT(level.sigma(), 0.03);
  }
  EXPECT_TRUE(corrected);
}

// A keyframe is held by up as the motion has it, which no acceleration bends, once that is known well.
TEST(MapLevel, KeyframesAreHeldByTheMotionsUp) {
  Robot robot;
  robot.rest = 0;
  robot.sway = 0.15;
  SlamSettings settings;
  CameraMotion motion(robot.camera, robot.mounting, settings);
  MapLevel level(settings);
  Random random(5);
  const auto cameraAt = [&](double t) { return Pose(robot.base(t) * robot.mounting.T_base_camera); };
  double next = 0.5;
  const auto known = [&] { return motion.estimate() && motion.estimate()->up_sigma < 0.01; };
  for (double t = 1; t < 30; t += 0.1) {
    for (; next <= t + 0.005; next += 0.005) motion.addImu(robot.imu(next, random));
    if (t == 1) level.begin(&motion.attitude());
    motion.addPose(t, cameraAt(t), 1e-8 * Matrix6d::Identity());
    const Eigen::Matrix3d R_map_camera = cameraAt(t).linear();
    const auto up = level.upInCamera(t, R_map_camera, motion);
    ASSERT_TRUE(up) << t;
    EXPECT_EQ(up->second <= 0.01, known()) << t;
    if (!known()) continue;
    EXPECT_LT((up->first - R_map_camera.transpose() * motion.estimate()->up).norm(), 1e-9) << t;
    EXPECT_LT((R_map_camera * up->first - Eigen::Vector3d::UnitZ()).norm(), 0.03) << t;
  }
  EXPECT_TRUE(known());
}

}  // namespace
}  // namespace rgbd_slam
