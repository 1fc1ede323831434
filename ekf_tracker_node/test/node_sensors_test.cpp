// The node with an odometry that has no scale yet, and its other sensors. Of the program of ekf_tracker_node_test.cpp.
#include "node_fixture.h"

namespace ekf_tracker::test {
namespace {

// As mav_vo before it knows the scale: increments in a unit of its own, no odometry; of a node in another namespace.
class UnscaledOdometryTest : public EkfTrackerNodeTest {
 protected:
  static constexpr int kEnd = 300;

  void begin(const std::string& name) {
    other_ = ros::NodeHandle(name);
    other_increments_ = other_.advertise<air_ground::VoIncrement>("mav/vo_increment", 400);
    imu_ = other_.advertise<sensor_msgs::Imu>("mav/imu/data", 1000);
    accelerometer_ = other_.advertise<sensor_msgs::Imu>("mav/accel", 1000);
    field_ = other_.advertise<sensor_msgs::MagneticField>("mav/imu/mag", 100);
    other_fixes_ = other_.advertise<geometry_msgs::PoseWithCovarianceStamped>("streetview/pose", 100);
    other_tracked_ = other_.subscribe<nav_msgs::Odometry>(
        "tracked/odometry", 1000, [this](const nav_msgs::Odometry::ConstPtr& m) { tracked_.push_back(*m); });
    outcomes_ = other_.subscribe<air_ground::TrackerInnovation>(
        "tracked/innovation", 100,
        [this](const air_ground::TrackerInnovation::ConstPtr& m) { innovations_.push_back(*m); });
    ASSERT_TRUE(spinUntil([this] {
      return other_increments_.getNumSubscribers() && other_fixes_.getNumSubscribers() &&
             other_tracked_.getNumPublishers() && outcomes_.getNumPublishers();
    }));
    edges_.clear();
  }

  // What an accelerometer in the body feels.
  static sensor_msgs::Imu gravity(int i, const std::string& frame = "mav_base_link") {
    const Eigen::Vector3d force = mapPose(i).linear().transpose() * Eigen::Vector3d(0, 0, 9.81);
    sensor_msgs::Imu m;
    m.header.stamp = timeOf(i);
    m.header.frame_id = frame;
    m.linear_acceleration.x = force.x(), m.linear_acceleration.y = force.y(), m.linear_acceleration.z = force.z();
    return m;
  }

  void flyUnscaled(int from, int to) {
    for (int i = from; i < to; ++i) {
      auto m = increment(i, i + 1);
      m.metric = false;
      for (double* x : {&m.relative_pose.position.x, &m.relative_pose.position.y, &m.relative_pose.position.z}) *x /= 2;
      other_increments_.publish(m);
      if (i % 40 == 39) pause(4);
    }
  }

  void expectTiltIsUsed() {
    flyUnscaled(0, kEnd - 20);
    for (int i : {20, 200, 270}) other_fixes_.publish(fix(i));
    ASSERT_TRUE(spinUntil([&] { return results(air_ground::TrackerInnovation::RESULT_INITIALISED) == 1; }));
    flyUnscaled(kEnd - 20, kEnd);
    ASSERT_TRUE(spinUntil([&] { return !tracked_.empty() && tracked_.back().header.stamp == timeOf(kEnd); }));
    // Without the tilt of 0.15 rad the way of 22 m would climb by three.
    expectOnTheWay(kEnd, 1.0);
    EXPECT_TRUE(edges_.empty());
  }

  ros::NodeHandle other_;
  ros::Publisher other_increments_, imu_, accelerometer_, field_, other_fixes_;
  ros::Subscriber other_tracked_, outcomes_;
};

// This node would wait for odometry for a minute.
TEST_F(UnscaledOdometryTest, OdometryThatIsNotMetricYetIsNotWaitedFor) {
  begin("unscaled");
  ASSERT_TRUE(spinUntil([&] { return imu_.getNumSubscribers() > 0; }));
  for (int i = 0; i <= kEnd; ++i) imu_.publish(gravity(i));
  pause(200);
  expectTiltIsUsed();
}

// RealSense without unite_imu_method: the IMU's topic holds turn rates alone. The declination is not set here.
TEST_F(UnscaledOdometryTest, GyroAndAccelerometerApart) {
  begin("apart");
  const ru::NodeDiagnostics diagnostics("apart/ekf_tracker");
  ASSERT_TRUE(spinUntil([&] { return accelerometer_.getNumSubscribers() && field_.getNumSubscribers(); }));
  for (int i = 0; i <= kEnd; ++i) {
    sensor_msgs::Imu turns = gravity(i);
    turns.linear_acceleration = geometry_msgs::Vector3();
    imu_.publish(turns);
    accelerometer_.publish(gravity(i, "/mav_base_link"));
    sensor_msgs::Imu bad = turns;
    if (i % 2) bad.linear_acceleration.x = 90, bad.linear_acceleration_covariance[0] = -1;
    accelerometer_.publish(bad);
  }
  const std::string ignored = "accelerations on " + accelerometer_.getTopic() + " ignored: not measured";
  EXPECT_TRUE(diagnostics.await(ignored, kEnd + 1));
  sensor_msgs::MagneticField field;
  field.header.stamp = timeOf(kEnd);
  field.header.frame_id = "mav_base_link";
  field.magnetic_field.x = 21e-6, field.magnetic_field.z = -43e-6;
  field_.publish(field);
  EXPECT_TRUE(diagnostics.await("magnetometer readings ignored: the declination is not known: set", 1));
  expectTiltIsUsed();
  for (const auto& m : innovations_) EXPECT_NE(m.source, air_ground::TrackerInnovation::SOURCE_HEADING);
}

// A drone of which there is but a video: what is up, fixes tell. Without it the 24 m after the last one would climb by
// 3.6.
TEST_F(UnscaledOdometryTest, FixesTellTheTiltWhereThereIsNoImu) {
  begin("unscaled");
  constexpr int kLater = kEnd + 300;
  flyUnscaled(0, kEnd - 20);
  for (int i : {20, 200, 270}) {
    auto m = fix(i);
    m.pose.covariance[21] = m.pose.covariance[28] = 1e-4;
    other_fixes_.publish(m);
  }
  ASSERT_TRUE(spinUntil([&] { return results(air_ground::TrackerInnovation::RESULT_INITIALISED) == 1; }));
  flyUnscaled(kEnd - 20, kLater);
  ASSERT_TRUE(spinUntil([&] { return !tracked_.empty() && tracked_.back().header.stamp == timeOf(kLater); }));
  expectOnTheWay(kLater, 3.0);  // the scale is that of two fixes
  const Pose T_world_base = ru::fromMsg(tracked_.back().pose.pose);
  EXPECT_NEAR(T_world_base.translation().z(), (kWorldMap * mapPose(kLater)).translation().z(), 0.7);
  const double cosine = T_world_base.linear().row(2).dot(mapPose(kLater).linear().row(2));
  EXPECT_LT(std::acos(std::min(1.0, cosine)), 0.01);
}

// The same with nobody having named the accelerometer's topic: zeros are no force, and the remedy is said.
TEST_F(UnscaledOdometryTest, GyroAloneTellsNoTilt) {
  begin("unscaled");
  const ru::NodeDiagnostics diagnostics("unscaled/ekf_tracker");
  ASSERT_TRUE(spinUntil([&] { return imu_.getNumSubscribers() > 0; }));
  sensor_msgs::Imu turns;
  turns.header.stamp = timeOf(0);
  turns.header.frame_id = "mav_base_link";
  imu_.publish(turns);
  EXPECT_TRUE(diagnostics.await("accelerations on " + imu_.getTopic() +
                                    " ignored: not measured. Where the accelerometer has a topic of its own, name it "
                                    "by the launch argument mav_imu_accel",
                                1));
}

// A driver that removes gravity leaves nothing to level by.
TEST_F(UnscaledOdometryTest, AccelerationsWithoutGravityTellNoTilt) {
  begin("unscaled");
  const ru::NodeDiagnostics diagnostics("unscaled/ekf_tracker");
  ASSERT_TRUE(spinUntil([&] { return imu_.getNumSubscribers() > 0; }));
  for (int i = 0; i <= kEnd; ++i) {
    sensor_msgs::Imu m = gravity(i);
    m.linear_acceleration.x = 1.5, m.linear_acceleration.y = m.linear_acceleration.z = 0.2;
    imu_.publish(m);
  }
  EXPECT_TRUE(diagnostics.await(
      "accelerations on " + imu_.getTopic() + " tell no tilt: they are not about 9.81 m/s^2. Is gravity removed",
      kEnd - 60));
}

TEST_F(EkfTrackerNodeTest, MagnetometerGpsAndBarometerAreHeard) {
  fly(0, 40);
  fixes_.publish(fix(20));
  fixes_.publish(fix(30));
  ASSERT_TRUE(spinUntil([&] { return results(air_ground::TrackerInnovation::RESULT_INITIALISED) == 1; }));
  for (int i = 40; i < 400; i += 20) {
    fly(i, i + 20);
    const Pose T_world_base = kWorldMap * mapPose(i + 10);
    sensor_msgs::MagneticField field;
    field.header.stamp = timeOf(i + 10);
    field.header.frame_id = "mav_base_link";
    const double d = 3.0 * M_PI / 180;
    const Eigen::Vector3d seen =
        T_world_base.linear().transpose() * Eigen::Vector3d(21e-6 * std::sin(d), 21e-6 * std::cos(d), -43e-6);
    field.magnetic_field.x = seen.x(), field.magnetic_field.y = seen.y(), field.magnetic_field.z = seen.z();
    magnetometer_.publish(field);
    gps_.publish(gps(i + 10));
    sensor_msgs::NavSatFix bad = gps(i + 410);
    bad.latitude = kNan;
    gps_.publish(bad);
    barometer_.publish(pressure(i + 10));
    pause(4);
  }
  ASSERT_TRUE(awaitStamp(400));
  std::map<int, int> fused;
  ASSERT_TRUE(spinUntil([&] {
    fused.clear();
    for (const auto& m : innovations_) fused[m.source] += m.result == air_ground::TrackerInnovation::RESULT_FUSED;
    return fused[air_ground::TrackerInnovation::SOURCE_HEADING] > 10 &&
           fused[air_ground::TrackerInnovation::SOURCE_BAROMETER] > 10;
  })) << fused[1]
      << ' ' << fused[2] << ' ' << fused[3];
  EXPECT_GE(fused[air_ground::TrackerInnovation::SOURCE_GPS], 1);
  EXPECT_LE(fused[air_ground::TrackerInnovation::SOURCE_GPS], 3);  // thinned to one in ten seconds
  const std::map<int, double> most = {{air_ground::TrackerInnovation::SOURCE_HEADING, 0.03},
                                      {air_ground::TrackerInnovation::SOURCE_BAROMETER, 0.2},
                                      {air_ground::TrackerInnovation::SOURCE_GPS, 1}};
  for (const auto& m : innovations_) {
    if (!m.predicted || most.count(m.source) == 0) continue;
    EXPECT_LT(std::abs(m.innovation[0]), most.at(m.source));
  }
  expectOnTheWay(400, 1.0);
  expectFinite();
}

// As where two fixes of a wrong place have started it.
TEST_F(EkfTrackerNodeTest, GpsThatContradictsThePoseIsToldUntilItAgrees) {
  int at = 40;
  fly(0, at);
  ASSERT_TRUE(giveFixes({10, 30}));
  // It flies on meanwhile: else it would tell of the odometry.
  const auto says = [&](const std::string& line) {
    return spinUntil([&] {
      fly(at, at + 1);
      return ++at, diagnostics_.message().rfind(line, 0) == 0;
    });
  };
  // One in ten seconds counts.
  const auto give = [&](const Eigen::Vector3d& error) {
    fly(at, at + 210);
    gps_.publish(gps((at += 210) - 5, error));
  };
  for (int i = 0; i < 2; ++i) give({80, 0, 0});
  EXPECT_TRUE(says("tracking: "));
  for (int i = 0; i < 2; ++i) give({80, 0, 0});
  EXPECT_TRUE(says("GPS contradicts the pose by 80 m")) << diagnostics_.message();
  EXPECT_EQ(diagnostics_.level(), diagnostic_msgs::DiagnosticStatus::WARN);
  EXPECT_TRUE(diagnostics_.await("GPS positions contradict the pose", 1));
  give({0, 0, 0});
  EXPECT_TRUE(says("tracking: ")) << diagnostics_.message();
}

}  // namespace
}  // namespace ekf_tracker::test
