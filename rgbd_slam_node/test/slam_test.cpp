#include "rgbd_slam/slam.h"

#include <gtest/gtest.h>

#include <functional>

#include "air_ground_common/linear_algebra.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::Robot;
using simulated::synthetic::Random;

using simulated::Drive;
using simulated::drive;
using simulated::worst;

TEST(Slam, CircleInAGravityAlignedMap) {
  Robot robot;
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 0, 7);
  int corrected = 0;
  double nees = 0;
  int count = 0;
  for (std::size_t i = 0; i < run.results.size(); ++i) {
    const SlamResult& r = run.results[i];
    corrected += r.map_corrected;
    if (r.state != State::kTracking) {
      EXPECT_LT(run.stamps[i], 0.3);
      continue;
    }
    // Position within a few centimetres though the map is levelled by a noisy accelerometer; heading right from the
    // start.
    const Pose truth = robot.mapped(run.stamps[i]);
    const Eigen::Vector3d e = r.T_map_base.translation() - truth.translation();
    EXPECT_LT(e.norm(), 0.035) << run.stamps[i];
    EXPECT_LT(air_ground_common::rotationAngle(r.T_map_base.linear(), truth.linear()),
              run.stamps[i] > 1.0 ? 0.012 : 0.04)
        << run.stamps[i];
    nees += air_ground_common::squaredMahalanobis(e, r.covariance.topLeftCorner<3, 3>());
    ++count;
    EXPECT_TRUE(air_ground_common::isPositiveDefinite(r.covariance));
  }
  EXPECT_LE(corrected, 1);  // levelled once, when rest was known
  EXPECT_TRUE(slam.gravityKnown());
  EXPECT_EQ(slam.counters().lost_frames, 0);
  EXPECT_LT((slam.gyroBias() - robot.gyro_bias).norm(), 0.004);
  EXPECT_LT(worst(run, slam.trajectory()), 0.03);
  EXPECT_LT(nees / count, 12.0);
  // The floor of the dense cloud is flat and where it should be.
  const auto cloud = fusePoints(slam.posedPoints(), SlamSettings().cloud);
  ASSERT_GT(cloud.size(), 5000u);
  double sum = 0, squares = 0;
  for (const CloudPoint& p : cloud) {
    sum += p.position.z();
    squares += p.position.z() * p.position.z();
  }
  EXPECT_NEAR(sum / cloud.size(), 0, 0.015);
  EXPECT_LT(std::sqrt(squares / cloud.size()), 0.02);
}

/// The true vertical in the map, by the pose of a frame.
Eigen::Vector3d upOf(const Robot& robot, const SlamResult& r, double t) {
  return r.T_map_base.linear() * robot.base(t).linear().transpose() * Eigen::Vector3d::UnitZ();
}

double angleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

TEST(Slam, LevelsAMapThatWasBegunInMotion) {
  Robot robot;
  robot.start = 2.1;  // the first image waits for the first specific forces
  robot.speed = 0.6;
  robot.gyro_bias = {0.12, -0.1, 0.12};  // 0.2 rad/s
  robot.accel_bias = {0.3, -0.3, 0.25};  // 0.5 m/s^2
  robot.tilt = {0.1, -0.06, 0};
  robot.sway = 0.02;
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 2, 12);
  EXPECT_EQ(slam.counters().lost_frames, 0);
  EXPECT_EQ(slam.counters().maps, 1);
  int corrected = 0;
  for (std::size_t i = 0; i < run.results.size(); ++i) {
    corrected += run.results[i].map_corrected;
    if (run.stamps[i] < 10) continue;
    EXPECT_LT(angleBetween(upOf(robot, run.results[i], run.stamps[i]), Eigen::Vector3d::UnitZ()), 0.5 * M_PI / 180)
        << run.stamps[i];
  }
  EXPECT_LE(corrected, 4);
  const Vertical vertical = slam.vertical();
  EXPECT_LT(vertical.stddev, 0.3 * M_PI / 180);
  EXPECT_LT(angleBetween(upOf(robot, run.results.back(), run.stamps.back()), vertical.up), 3 * vertical.stddev);
  EXPECT_LT((slam.gyroBias() - robot.gyro_bias).norm(), 0.004);
  EXPECT_LT((slam.inertialEstimate()->accel_bias - robot.accel_bias).norm(), 0.12);
  EXPECT_LT(worst(run, slam.trajectory()), 0.08);
}

TEST(Slam, AGyroInDegreesIsNamedAndLeftOut) {
  for (const bool degrees : {true, false}) {
    Robot robot;
    robot.sway = 0.08;
    robot.sway_rate = 2;  // it turns by up to 0.3 rad/s
    robot.gyro_matrix = degrees ? Eigen::Matrix3d(180 / M_PI * Eigen::Matrix3d::Identity())
                                : Eigen::Matrix3d(Eigen::Vector3d(1, -1, -1).asDiagonal());
    Slam slam(robot.camera, robot.mounting, {});
    drive(robot, slam, 0, 12);
    const Drive later = drive(robot, slam, 12.1, 16);
    const std::string expected = degrees ? "the gyro by 5" : "correlation -";
    EXPECT_NE(later.results.back().imu_problem.find("gyro and images turn differently"), std::string::npos);
    EXPECT_NE(later.results.back().imu_problem.find(expected), std::string::npos) << later.results.back().imu_problem;
    for (const SlamResult& r : later.results) EXPECT_TRUE(r.state == State::kTracking && !r.relocalized) << r.reason;
    EXPECT_EQ(slam.counters().maps, 1);
    // The circle as it was driven, but for where up is.
    std::vector<Pose> truth, estimate;
    for (std::size_t i = 0; i < later.results.size(); ++i) {
      truth.push_back(later.truth[0].T_map_body.inverse() * later.truth[i].T_map_body);
      estimate.push_back(later.results[0].T_map_camera.inverse() * later.results[i].T_map_camera);
    }
    EXPECT_LT((truth.back().translation() - estimate.back().translation()).norm(), 0.03);
  }
}

/// In a room whose walls show nothing but their shape, looking 35 degrees down.
Robot inARoom() {
  Robot robot;
  robot.walls = true;
  robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                                          air_ground_common::opticalFromForwardBody().transpose();
  return robot;
}

bool isDark(double t) { return t > 3 && t < 6; }

TEST(Slam, GoesOnInTheDarkByTheShapeOfTheRoom) {
  const Robot robot = inARoom();
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 0, 8, true, isDark);
  EXPECT_GT(slam.counters().by_depth, 20);
  EXPECT_EQ(slam.counters().lost_frames, 0);
  EXPECT_EQ(slam.counters().maps, 1);
  for (std::size_t i = 0; i < run.results.size(); ++i) {
    const SlamResult& r = run.results[i];
    if (run.stamps[i] < 1) continue;
    ASSERT_EQ(r.state, State::kTracking) << run.stamps[i] << " " << r.reason;
    const Eigen::Vector3d e = r.T_map_base.translation() - robot.mapped(run.stamps[i]).translation();
    EXPECT_LT(e.norm(), 0.015) << run.stamps[i];
    EXPECT_LT(air_ground_common::squaredMahalanobis(e, r.covariance.topLeftCorner<3, 3>()), 20) << run.stamps[i];
  }
  // In the light again the images are believed again.
  EXPECT_FALSE(run.results.back().by_depth);
  EXPECT_GT(run.results.back().inliers, 40);
  EXPECT_LT(worst(run, slam.trajectory()), 0.015);
}

TEST(Slam, AFloorAloneIsNoWayThroughTheDark) {
  Robot robot = inARoom();
  robot.walls = false;
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 5, true, isDark);
  EXPECT_EQ(slam.counters().by_depth, 0);
  EXPECT_GT(slam.counters().lost_frames, 15);
}

TEST(Slam, WithoutSurfacesDarknessIsALoss) {
  const Robot robot = inARoom();
  SlamSettings settings;
  settings.use_surfaces = false;
  Slam slam(robot.camera, robot.mounting, settings);
  drive(robot, slam, 0, 8, true, isDark);
  EXPECT_GT(slam.counters().lost_frames, 15);
  EXPECT_EQ(slam.counters().by_depth, 0);
}

TEST(Slam, LostItLooksForItsPlaceTenTimesASecond) {
  Robot robot;
  robot.rest = 0.8;
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 3);
  const int before = slam.counters().relocalization_attempts;
  EXPECT_EQ(before, 0);
  Random random(5);
  auto dark = robot.frame(3, random);
  dark.gray.setTo(15);
  SlamResult r;
  int i = 0;
  for (; i < 60; ++i) r = slam.process(3.1 + i / 30.0, dark.gray, cv::Mat(), dark.depth);
  EXPECT_EQ(r.state, State::kLost);
  EXPECT_FALSE(r.reason.empty());
  EXPECT_GE(slam.counters().relocalization_attempts, 14);
  EXPECT_LE(slam.counters().relocalization_attempts, 21);
  // Seen again, it is found within a tenth of a second.
  const auto frame = robot.frame(2.0, random);
  int frames = 0;
  for (; frames < 6 && r.state != State::kTracking; ++i, ++frames)
    r = slam.process(3.1 + i / 30.0, frame.gray, cv::Mat(), frame.depth);
  EXPECT_EQ(r.state, State::kTracking);
  EXPECT_LE(frames, 4);
}

TEST(Slam, SameInputSameOutput) {
  Robot robot;
  Slam a(robot.camera, robot.mounting, {}), b(robot.camera, robot.mounting, {});
  const Drive ra = drive(robot, a, 0, 2.5), rb = drive(robot, b, 0, 2.5);
  for (std::size_t i = 0; i < ra.results.size(); ++i)
    EXPECT_EQ(ra.results[i].T_map_base.matrix(), rb.results[i].T_map_base.matrix());
}

TEST(Slam, WithoutImuTheBaseCountsAsLevel) {
  Robot robot;
  robot.tilt.setZero();
  robot.mounting.R_base_imu.reset();
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 0, 4, false);
  EXPECT_FALSE(slam.gravityKnown());
  EXPECT_EQ(run.results.front().state, State::kTracking);
  EXPECT_TRUE(run.results.front().new_map);
  EXPECT_LT(run.results.front().T_map_base.translation().norm(), 1e-9);
  EXPECT_LT(worst(run, slam.trajectory()), 0.03);
}

TEST(Slam, PureRotationMakesLandmarks) {
  Robot robot;
  robot.spin = true;
  // The camera sits on the axis of the turn: not a millimetre of parallax.
  robot.mounting.T_base_camera.translation() = Eigen::Vector3d(0, 0, 1.2);
  robot.tilt.setZero();
  robot.speed = 0.4;
  Slam slam(robot.camera, robot.mounting, {});
  const Drive run = drive(robot, slam, 0, 5);
  EXPECT_EQ(slam.counters().lost_frames, 0);
  EXPECT_GT(slam.map().keyframeCount(), 4u);
  EXPECT_GT(slam.map().landmarkCount(), 300u);
  EXPECT_LT(worst(run, slam.trajectory()), 0.02);
}

TEST(Slam, StandingStillMakesNoKeyframes) {
  Robot robot;
  robot.rest = 1e3;
  SlamSettings settings;
  settings.tracker.max_features = 40;  // fewer than three times the inliers that a pose needs
  settings.min_start_features = 20;
  Slam slam(robot.camera, robot.mounting, settings);
  Random random(2);
  std::vector<Robot::Frame> frames;
  for (int i = 0; i < 6; ++i) frames.push_back(robot.frame(0.1 * i, random));
  double next_imu = 0;
  for (int i = 0; i < 600; ++i) {
    const double t = 0.1 * i;
    for (; next_imu <= t + 0.005; next_imu += 0.005) slam.addImu(robot.imu(next_imu, random));
    const Robot::Frame& frame = frames[i % frames.size()];
    slam.process(t, frame.gray, cv::Mat(), frame.depth);
  }
  EXPECT_EQ(slam.counters().lost_frames, 0);
  EXPECT_LE(slam.counters().keyframes, 5);
}

TEST(Slam, OnlyTheNearestKeyframesKeepTheirImage) {
  Robot robot;
  SlamSettings settings;
  settings.local_keyframes = settings.max_image_keyframes = 4;
  Slam slam(robot.camera, robot.mounting, settings);
  const Drive run = drive(robot, slam, 0, 6);
  int with_image = 0;
  for (const auto& entry : slam.map().keyframes()) with_image += !entry.second.pyramid.empty();
  EXPECT_GT(slam.map().keyframeCount(), 6u);
  EXPECT_EQ(with_image, 4);
  EXPECT_FALSE(slam.map().keyframes().rbegin()->second.pyramid.empty());
  EXPECT_LT(worst(run, slam.trajectory()), 0.03);
}

TEST(Slam, RoundsOverTheSameGroundAddNothing) {
  Robot robot;
  robot.radius = 0.5;
  robot.speed = 0.6;
  robot.rest = 0;
  const double round = 2 * M_PI * robot.radius / robot.speed;
  Slam slam(robot.camera, robot.mounting, {});
  Drive run = drive(robot, slam, 0, 1.5 * round);
  const std::size_t keyframes = slam.map().keyframeCount(), landmarks = slam.map().landmarkCount();
  const auto points = [&] {
    std::size_t count = 0;
    for (const PosedPoints& k : slam.posedPoints()) count += k.points->size();
    return count;
  };
  const std::size_t dense = points();
  const Drive more = drive(robot, slam, 1.5 * round + 0.1, 4.5 * round);
  EXPECT_EQ(slam.counters().lost_frames, 0);
  EXPECT_LT(slam.map().keyframeCount(), 1.1 * keyframes);
  EXPECT_LT(slam.map().landmarkCount(), 1.1 * landmarks);
  EXPECT_LT(points(), 1.1 * dense);
  // Each frame has its pose all the same, as good as before.
  run.truth.insert(run.truth.end(), more.truth.begin(), more.truth.end());
  EXPECT_EQ(slam.trajectory().size() + 1, run.truth.size());  // the first one waits for the IMU
  EXPECT_LT(worst(run, slam.trajectory()), 0.04);
}

TEST(Slam, LostSaysSoAndFindsItsWayBack) {
  Robot robot;
  robot.rest = 0.8;
  Slam slam(robot.camera, robot.mounting, {});
  // Covered for two seconds, then the robot stands where it was before.
  const auto blind = [](double t) { return t > 3.0 && t < 4.5; };
  const Drive run = drive(robot, slam, 0, 4.4, true, blind);
  EXPECT_EQ(run.results.back().state, State::kLost);
  EXPECT_FALSE(run.results.back().reason.empty());
  const std::size_t poses = slam.trajectory().size();
  Random random(5);
  const auto frame = robot.frame(2.0, random);
  const SlamResult r = slam.process(5.0, frame.gray, cv::Mat(), frame.depth);
  ASSERT_EQ(r.state, State::kTracking) << r.reason;
  EXPECT_TRUE(r.relocalized);
  EXPECT_LT((r.T_map_base.translation() - robot.mapped(2.0).translation()).norm(), 0.02);
  EXPECT_EQ(slam.trajectory().size(), poses + 1);
}

TEST(Slam, LostAmongUnknownPlacesItBeginsANewMap) {
  Robot robot;
  Slam slam(robot.camera, robot.mounting, {});
  drive(robot, slam, 0, 3);
  Random random(5);
  Robot elsewhere;
  elsewhere.texture = visual_frontend::synthetic::texture(1800, 8);
  elsewhere.texture.convertTo(elsewhere.texture, -1, 1.8, -102);
  const auto known = robot.frame(2, random), strange = elsewhere.frame(2, random);
  auto dark = known;
  dark.gray = cv::Mat(known.gray.size(), CV_8U, cv::Scalar(15));
  double t = 3;
  const auto see = [&](const Robot::Frame& frame, double seconds) {
    SlamResult r;
    for (int i = 0; i < std::lround(10 * seconds); ++i) r = slam.process(t += 0.1, frame.gray, cv::Mat(), frame.depth);
    return r;
  };
  // Covered for long, then a person in front of it for four seconds: the map is kept, and known ground found again.
  EXPECT_EQ(see(dark, 12).state, State::kLost);
  EXPECT_EQ(see(strange, 4).state, State::kLost);
  const SlamResult back = see(known, 0.5);
  EXPECT_EQ(back.state, State::kTracking) << back.reason;
  EXPECT_LT((back.T_map_base.translation() - robot.mapped(2).translation()).norm(), 0.02);
  EXPECT_EQ(slam.mapId(), 1);
  // A gap in the recording, and nothing known after it: a new map.
  t += 8;
  EXPECT_EQ(see(strange, 4.5).state, State::kLost);
  const EndedMap before = slam.asEnded();
  std::shared_ptr<const EndedMap> ended;
  for (int i = 0; i < 10 && !ended; ++i) ended = see(strange, 0.1).ended;
  ASSERT_TRUE(ended) << "what was mapped is not lost with the map";
  EXPECT_EQ(ended->trajectory.size(), before.trajectory.size());
  EXPECT_GT(fusePoints(ended->points, {}).size(), 3000u);
  const SlamResult anew = see(strange, 1.5);
  EXPECT_EQ(anew.state, State::kTracking) << anew.reason;
  EXPECT_EQ(slam.mapId(), 2);
  EXPECT_EQ(slam.counters().maps, 2);
}

TEST(Slam, LandmarksBeginWhereverDepthIsInRange) {
  for (const double scale : {1.0, 0.1, 15.0}) {  // the camera is up to 18 m above the floor
    Robot robot;
    robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX()).toRotationMatrix();
    robot.mounting.T_base_camera.translation() = Eigen::Vector3d(0, 0, 1.2 * scale);
    robot.mounting.R_base_imu.reset();
    robot.tilt.setZero();
    robot.floor *= scale;
    SlamSettings settings;
    settings.depth.min_range = 0.05;
    settings.depth.max_range = 20;
    Slam slam(robot.camera, robot.mounting, settings);
    const auto frame = robot.render(0);
    ASSERT_EQ(slam.process(0, frame.gray, cv::Mat(), frame.depth).state, State::kTracking);
    EXPECT_GT(slam.map().landmarkCount(), 100u) << scale;
    for (const auto& entry : slam.map().landmarks()) EXPECT_NEAR(entry.second.position.z(), 0, 0.02 * scale);
  }
}

TEST(Slam, WaitsForDepthAndRefusesBadInput) {
  Robot robot;
  Slam slam(robot.camera, robot.mounting, {});
  Random random(1);
  const auto frame = robot.frame(0, random);
  const cv::Mat no_depth(480, 640, CV_32F, cv::Scalar(NAN));
  const SlamResult r = slam.process(1, frame.gray, cv::Mat(), no_depth);
  EXPECT_EQ(r.state, State::kInitializing);
  EXPECT_NE(r.reason.find("depth"), std::string::npos);
  EXPECT_THROW(slam.process(1, frame.gray, cv::Mat(), frame.depth), std::invalid_argument);  // the same stamp
  EXPECT_THROW(slam.process(2, frame.depth, cv::Mat(), frame.depth), std::invalid_argument);
  EXPECT_THROW(slam.process(2, frame.gray, cv::Mat(), cv::Mat(10, 10, CV_32F)), std::invalid_argument);
  // No IMU sample came: after the timeout the base counts as level.
  EXPECT_EQ(slam.process(1.5, frame.gray, cv::Mat(), frame.depth).state, State::kInitializing);
  EXPECT_EQ(slam.process(2.5, frame.gray, cv::Mat(), frame.depth).state, State::kTracking);
  slam.reset();
  EXPECT_TRUE(slam.trajectory().empty());
  EXPECT_EQ(slam.process(1, frame.gray, cv::Mat(), frame.depth).state, State::kInitializing);
  SlamSettings bad;
  bad.keyframe_overlap = 1.5;
  EXPECT_THROW(Slam(robot.camera, robot.mounting, bad), std::invalid_argument);
}

}  // namespace
}  // namespace rgbd_slam
