// The whole odometry on rendered flights: accuracy, scale, determinism, and what a bad day brings.
#include <gtest/gtest.h>

#include "air_ground_common/linear_algebra.h"
#include "air_ground_common/trajectory.h"
#include "rendered_flight.h"

using namespace mav_vo;
using air_ground_common::Alignment;

namespace {

TEST(Odometry, IsMetricAndAccurate) {
  const Outcome o = fly(Options{});
  ASSERT_GT(o.metric_at, 0);
  EXPECT_LT(o.metric_at, 8.0);
  double scale_error = 1;
  const double error = ate(o, o.final_poses, &scale_error);
  const double length = air_ground_common::pathLength(o.truth);
  std::printf("metric after %.2f s; final ATE %.4f m of %.2f m (%.3f %%), scale error %+.3f %%, as published %.4f m\n",
              o.metric_at, error, length, 100 * error / length, 100 * scale_error, ate(o, o.online));
  EXPECT_LT(error, 0.01 * length);
  EXPECT_LT(std::abs(scale_error), 0.015);
  EXPECT_LT(ate(o, o.online), 0.02 * length);
  // Once metric, it does not lose its way, and says how sure it is.
  for (const VoResult& r : o.frames) {
    if (r.stamp < o.metric_at) continue;
    EXPECT_TRUE(r.pose_valid) << r.stamp << " " << r.reason;
    EXPECT_LT(std::abs(r.scale - 1), 5 * r.scale_stddev + 0.01);
    EXPECT_NEAR(r.scale_deviation, std::hypot(r.scale_stddev / r.scale, r.scale - 1), 1e-12);
    EXPECT_GT(r.depth_min, 0.3);
    EXPECT_LT(r.depth_max, 4.0);
  }
  // Gravity-aligned with heading 0 at the first keyframe.
  const Outcome& c = o;
  for (std::size_t i = 0; i < c.online.size(); i += 20) {
    const auto truth = air_ground_common::poseAt(c.truth, c.online[i].stamp);
    const Eigen::Vector3d up = c.online[i].T_map_body.linear().row(2), up_truth = truth->linear().row(2);
    EXPECT_LT(std::acos(std::min(1.0, up.dot(up_truth))), 0.02);
  }
}

/// Largest angle between what the published poses call up and the truth [rad].
double worstTilt(const Outcome& o) {
  double worst = 0;
  for (std::size_t i = 0; i < o.online.size(); i += 10) {
    const auto truth = air_ground_common::poseAt(o.truth, o.online[i].stamp);
    const Eigen::Vector3d up = o.online[i].T_map_body.linear().row(2), up_truth = truth->linear().row(2);
    worst = std::max(worst, std::acos(std::min(1.0, up.dot(up_truth))));
  }
  return worst;
}

// From the first image on in flight, with an IMU nobody has calibrated.
TEST(Odometry, StartsInMotionWithLargeBiases) {
  Options options;
  options.flight.wobble = 0.15;
  options.begin = 5;
  options.end = 17;
  options.bias = {{0.11, -0.13, 0.1}, {0.3, -0.3, 0.25}};
  const Outcome o = fly(options);
  ASSERT_GT(o.metric_at, 0) << o.frames.back().reason;
  double scale_error = 1;
  const double error = ate(o, o.final_poses, &scale_error), length = air_ground_common::pathLength(o.truth);
  const VoResult& last = o.frames.back();
  std::printf(
      "metric after %.2f s; final ATE %.4f m of %.2f m, scale %+.3f %%, tilt %.2f deg, gyro bias off %.4f rad/s, "
      "accelerometer's %.3f m/s^2\n",
      o.metric_at - options.begin, error, length, 100 * scale_error, worstTilt(o) * 180 / M_PI,
      (last.imu_bias.gyro - options.bias.gyro).norm(), (last.imu_bias.accel - options.bias.accel).norm());
  EXPECT_LT(o.metric_at - options.begin, 8.0);
  EXPECT_LT(error, 0.01 * length);
  EXPECT_LT(std::abs(scale_error), 0.015);
  EXPECT_LT(worstTilt(o), 0.5 * M_PI / 180);
  EXPECT_LT((last.imu_bias.gyro - options.bias.gyro).norm(), 0.005);
  for (const VoResult& r : o.frames)
    EXPECT_TRUE(r.pose_valid || r.stamp < options.begin + 1.5) << r.stamp << " " << r.reason;
}

TEST(Odometry, FindsTheTimeOffset) {
  Options options;
  options.flight.wobble = 0.15;
  options.imu_shift = 0.03;
  const Outcome o = fly(options);
  const VoResult& last = o.frames.back();
  std::printf("time offset %.2f +- %.2f ms, ATE %.4f m\n", 1e3 * last.time_offset, 1e3 * last.time_offset_stddev,
              ate(o, o.final_poses));
  EXPECT_NEAR(last.time_offset, options.imu_shift, 0.004);
  EXPECT_LT(last.time_offset_stddev, 0.004);
  ASSERT_GT(o.metric_at, 0) << last.reason;
  EXPECT_LT(ate(o, o.final_poses), 0.015 * air_ground_common::pathLength(o.truth));
}

TEST(Odometry, WithoutAGyroTheLastTurnTellsWhatRowsAreLate) {
  Options options;
  options.flight.wobble = 0.15;
  options.imu = false;
  options.readout = 0.03;
  OdometrySettings given;
  given.readout_time_stddev = 0;
  const double untold = shapeError(fly(options, given));
  const Outcome found = fly(options);
  options.told = true;
  const double told = shapeError(fly(options, given));
  const double readout = found.frames.back().readout_time;
  std::printf("without IMU, readout time 30 ms: ATE after similarity %.4f m, told %.4f m, found to be %.1f ms %.4f m\n",
              untold, told, 1e3 * readout, shapeError(found));
  EXPECT_LT(told, 0.7 * untold);
  EXPECT_LT(shapeError(found), 0.7 * untold);
  EXPECT_NEAR(readout, options.readout, 0.006);
}

// As cameras without a shutter are built: a row is read out until about the next image. Velocities of two poses swung
// up: what was wrong with one carried the next one's rows astray.
TEST(Odometry, RowsThatAreReadOutUntilTheNextImage) {
  Options options;
  options.flight.wobble = 0.15;
  options.period = 1.0 / 30;
  options.readout = 0.03;
  options.tilt = 0.7;
  options.told = true;
  OdometrySettings settings;
  settings.gyro_prior_sigma = 0.05;  // the landmarks alone tell turns from shifts
  const Outcome o = fly(options, settings);
  std::printf("metric at %.1f s, ATE after similarity %.4f m\n", o.metric_at, shapeError(o));
  EXPECT_GT(o.metric_at, 0);
  EXPECT_LT(o.metric_at, 6);
  EXPECT_LT(shapeError(o), 0.012);
}

// k1 of the camera is 0.04 less than the calibration says.
TEST(Odometry, FindsThatTheCalibrationIsOff) {
  for (const bool imu : {true, false}) {
    Options options;
    options.flight.wobble = 0.15;
    options.imu = imu;
    options.radial = 0.04;
    OdometrySettings believing;
    believing.radial_stddev = 0;
    const Outcome believed = fly(options, believing), found = fly(options);
    std::printf("%s IMU: k1 off by %.4f instead of %.4f, ATE after similarity %.4f m instead of %.4f m\n",
                imu ? "with" : "without", found.camera.k1 - synthetic::camera().k1, options.radial, shapeError(found),
                shapeError(believed));
    EXPECT_EQ(believed.camera.k1, synthetic::camera().k1 + options.radial);
    EXPECT_NEAR(found.camera.k1, synthetic::camera().k1, 0.008);
    EXPECT_LT(shapeError(found), 0.6 * shapeError(believed));
    EXPECT_EQ(imu, found.metric_at > 0);
  }
}

TEST(Odometry, KeepsACalibrationThatIsRight) {
  for (const bool imu : {true, false}) {
    Options options;
    options.imu = imu;
    const Outcome o = fly(options);
    EXPECT_EQ(o.camera.k1, synthetic::camera().k1);
    EXPECT_EQ(o.frames.back().readout_time, 0);
  }
}

TEST(Odometry, ResetBelievesTheCalibrationAgain) {
  Options options;
  options.flight.wobble = 0.15;
  options.imu = false;
  OdometrySettings settings;
  settings.use_imu = false;
  const CameraModel told = visual_frontend::withRadial(synthetic::camera(), 0.04);
  Odometry odometry(told, synthetic::T_imu_camera(), Pose::Identity(), settings);
  fly(options, settings, &odometry);
  EXPECT_LT(odometry.camera().k1, told.k1 - 0.02);
  odometry.reset();
  EXPECT_EQ(odometry.camera().k1, told.k1);
}

TEST(Odometry, TakesAGlobalShutterForOne) {
  Options options;
  options.flight.wobble = 0.15;
  for (const VoResult& r : fly(options).frames) EXPECT_EQ(r.readout_time, 0) << r.stamp;
}

TEST(Odometry, IncrementsCarryAnHonestCovariance) {
  // Normalised errors of (x, y, z, yaw) between consecutive images; 4 on average if the covariance is honest. The
  // paper's scatter of minimal samples is cautious by construction.
  const Outcome o = fly({});
  double scatter = 0, poses = 0, variance_ratio = 0;
  int count = 0, cautious = 0;
  for (const VoResult& r : o.frames) {
    if (!r.increment || !r.metric) continue;
    const Increment& step = *r.increment;
    const auto truthAt = [&](double stamp) {
      for (const auto& pose : o.truth) {
        if (std::abs(pose.stamp - stamp) < 1e-6) return Pose(pose.T_map_body * synthetic::T_imu_camera().inverse());
      }
      ADD_FAILURE() << "no true pose at " << stamp;
      return Pose(Pose::Identity());
    };
    const Pose T_previous = truthAt(step.previous_stamp), truth = T_previous.inverse() * truthAt(r.stamp);
    Eigen::Vector4d e;
    e.head<3>() = step.T_previous_current.translation() - truth.translation();
    e[3] =
        (T_previous.linear() * air_ground_common::logSO3(step.T_previous_current.linear() * truth.linear().transpose()))
            .z();
    EXPECT_GT(air_ground_common::symmetricEigen(step.covariance).values[0], 0);
    EXPECT_NEAR((step.covariance - step.covariance.transpose()).norm(), 0, 1e-15);
    scatter += air_ground_common::squaredMahalanobis(e, step.covariance);
    poses += air_ground_common::squaredMahalanobis(e, step.pose_covariance);
    variance_ratio +=
        std::sqrt(step.covariance.topLeftCorner<3, 3>().trace() / step.pose_covariance.topLeftCorner<3, 3>().trace());
    cautious += step.covariance.trace() >= step.pose_covariance.trace();
    ++count;
  }
  ASSERT_GT(count, 80);
  std::printf(
      "increments: %d, mean NEES %.2f (monte_carlo), %.2f (poses), 4 expected; standard deviations %.1f times larger\n",
      count, scatter / count, poses / count, variance_ratio / count);
  EXPECT_LT(scatter / count, 4.5);
  EXPECT_LT(poses / count, 12);
  EXPECT_GT(cautious, 0.9 * count);
}

TEST(Odometry, PosesCarryAnHonestCovariance) {
  // Normalised errors of the base's position in the map, 3 on average if the covariance is honest, of accelerometers
  // whose scale factors are as far off as it allows for. Errors of one flight belong together, so the bounds are wide.
  const double scale_stddev = OdometrySettings{}.accel_scale_stddev;
  double sum = 0;
  int count = 0;
  for (int seed = 1; seed <= 3; ++seed) {
    Options options;
    options.accel_scale = 1 + (seed - 2) * std::sqrt(1.5) * scale_stddev;  // their mean square is the variance
    options.seed = 100 + seed;
    options.grain = 200 + seed;
    options.end = 11;
    Odometry odometry(synthetic::camera(), synthetic::T_imu_camera(), Pose::Identity(), OdometrySettings{});
    const Outcome o = fly(options, {}, &odometry);
    ASSERT_GT(o.metric_at, 0);
    const Pose first = options.flight.T_world_imu(odometry.map().keyframes().begin()->second.stamp);
    const Pose T_map_world =
        air_ground_common::yawPose(air_ground_common::yawOf(first.linear()), first.translation()).inverse();
    double flight = 0;
    int frames = 0;
    for (const VoResult& r : o.frames) {
      if (!r.metric || !r.pose_valid) continue;
      const Eigen::Vector3d e =
          r.T_map_base.translation() - (T_map_world * options.flight.T_world_imu(r.stamp)).translation();
      flight += air_ground_common::squaredMahalanobis(e, r.covariance.topLeftCorner<3, 3>());
      ++frames;
    }
    std::printf("flight %d: mean NEES %.2f of %d poses, 3 expected\n", seed, flight / frames, frames);
    sum += flight;
    count += frames;
  }
  EXPECT_GT(sum / count, 0.5);
  EXPECT_LT(sum / count, 6);
}

// At one heading a biased accelerometer looks like a map that leans; turns tell them apart.
TEST(Odometry, TheTiltItStatesIsHonestAtOneHeading) {
  double stated = 0;
  for (const double yaw_rate : {0.0, 0.15}) {
    Options options;
    options.flight.yaw_rate = yaw_rate;
    options.flight.wobble = 0.02;
    options.bias.accel = {0.2, -0.14, 0.06};
    const Outcome o = fly(options);
    ASSERT_GT(o.metric_at, 0);
    for (const VoResult& r : o.frames) {
      if (!r.metric || !r.pose_valid) continue;
      const Pose T = options.flight.T_world_imu(r.stamp) * synthetic::T_imu_camera();
      const Eigen::Vector3d up = r.T_map_camera.linear() * T.linear().transpose() * Eigen::Vector3d::UnitZ();
      EXPECT_LT(std::acos(std::min(1.0, up.z())), 3 * r.vertical.stddev)
          << yaw_rate << " rad/s, at " << r.stamp << " s";
    }
    if (yaw_rate == 0) stated = o.frames.back().vertical.stddev;
    if (yaw_rate > 0) {
      EXPECT_LT(o.frames.back().vertical.stddev, stated / 3);
    }
  }
}

TEST(Odometry, NeverClaimsMetresWithAWrongImu) {
  // Mounted otherwise than told.
  Pose turned = Pose::Identity();
  turned.linear() = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  Odometry mounted(synthetic::camera(), synthetic::T_imu_camera(), turned, OdometrySettings{});
  EXPECT_LT(fly(Options{}, {}, &mounted).metric_at, 0);
  // Known to be wrong.
  Options options;
  options.end = 9;
  Odometry known(synthetic::camera(), synthetic::T_imu_camera(), Pose::Identity(), OdometrySettings{});
  known.setImuProblem("the IMU reports g");
  const Outcome o = fly(options, {}, &known);
  EXPECT_LT(o.metric_at, 0);
  EXPECT_EQ(o.frames.back().state, OdometryState::kScaling);
  EXPECT_EQ(o.frames.back().reason, "the IMU reports g");
}

TEST(Odometry, SameInputSameOutput) {
  Options options;
  options.end = 5;
  const Outcome a = fly(options), b = fly(options);
  ASSERT_EQ(a.final_poses.size(), b.final_poses.size());
  for (std::size_t i = 0; i < a.final_poses.size(); ++i)
    ASSERT_EQ(a.final_poses[i].T_map_body.matrix(), b.final_poses[i].T_map_body.matrix()) << i;
}

TEST(Odometry, StartsInFlight) {
  Options options;
  options.begin = 4;
  options.end = 14;
  const Outcome o = fly(options);
  ASSERT_GT(o.metric_at, 0);
  double scale_error = 1;
  const double error = ate(o, o.final_poses, &scale_error);
  std::printf("start in flight: metric after %.2f s, ATE %.4f m, scale error %+.3f %%\n", o.metric_at - options.begin,
              error, 100 * scale_error);
  EXPECT_LT(error, 0.02 * air_ground_common::pathLength(o.truth));
  EXPECT_LT(std::abs(scale_error), 0.02);
}

TEST(Odometry, WithoutImuItTracksButNeverClaimsMetres) {
  Options options;
  options.imu = false;
  options.end = 7;
  const Outcome o = fly(options);
  EXPECT_LT(o.metric_at, 0);
  ASSERT_GT(o.final_poses.size(), 60u);
  EXPECT_LT(air_ground_common::absoluteTrajectoryError(o.truth, o.final_poses, Alignment::kSimilarity).rmse, 0.05);
  EXPECT_EQ(o.frames.back().state, OdometryState::kScaling);
}

TEST(Odometry, SurvivesDroppedImagesExposureChangesAndBadImuSamples) {
  Options options;
  options.drop_image = [](double t) { return std::fmod(t, 1.7) < 0.16; };  // three in a row
  options.gain = [](double t) { return 1.0 + 0.25 * std::sin(3 * t); };
  options.nan_imu = [](double t) { return std::fmod(t, 0.9) < 0.004; };
  const Outcome o = fly(options);
  ASSERT_GT(o.metric_at, 0);
  double scale_error = 1;
  EXPECT_LT(ate(o, o.final_poses, &scale_error), 0.02 * air_ground_common::pathLength(o.truth));
  EXPECT_LT(std::abs(scale_error), 0.02);
}

// A link that loses a packet of 60 ms more often than once a second: the scale starts all the same.
TEST(Odometry, FindsItsScaleOverLostPackets) {
  Options options;
  options.nan_imu = [](double t) { return std::fmod(t + 10, 0.9) < 0.06; };
  const Outcome o = fly(options);
  ASSERT_GT(o.metric_at, 0) << o.frames.back().reason;
  EXPECT_LT(o.metric_at, 9);
  EXPECT_LT(ate(o, o.final_poses), 0.05);
}

TEST(Odometry, BridgesAGapInTheImu) {
  Options options;
  options.nan_imu = [](double t) { return t > 9 && t < 10.3; };
  const Outcome o = fly(options);
  EXPECT_EQ(o.frames.back().state, OdometryState::kTracking);
  EXPECT_LT(ate(o, o.final_poses), 0.05);
}

TEST(Odometry, ResetGivesANewMap) {
  Options options;
  options.end = 5;
  Odometry odometry(synthetic::camera(), synthetic::T_imu_camera(), Pose::Identity(), OdometrySettings{});
  const Outcome first = fly(options, {}, &odometry);
  odometry.reset();
  EXPECT_TRUE(odometry.trajectory().empty());
  const Outcome second = fly(options, {}, &odometry);  // time runs again from the start, as in a looped bag
  EXPECT_GT(second.frames.front().map_id, first.frames.back().map_id);
  ASSERT_EQ(first.final_poses.size(), second.final_poses.size());
  EXPECT_LT(
      (first.final_poses.back().T_map_body.translation() - second.final_poses.back().T_map_body.translation()).norm(),
      1e-6);
}

// A recording played again and again: the vehicle is carried back at each seam, which no IMU reports. The map survives
// that, and holds no more than its places need.
TEST(Odometry, TheSameRoundAgainNeedsNoMoreMemory) {
  OdometrySettings settings;
  settings.full_max_keyframes = 12;
  Odometry odometry(synthetic::camera(), synthetic::T_imu_camera(), Pose::Identity(), settings);
  Options options;
  options.end = 8;
  fly(options, settings, &odometry);
  std::size_t keyframes = 0, landmarks = 0;
  for (int round = 1; round <= 3; ++round) {
    options.replay += 8;
    const Outcome o = fly(options, settings, &odometry);
    EXPECT_EQ(odometry.mapId(), 1u);
    EXPECT_EQ(o.frames.back().state, OdometryState::kTracking) << o.frames.back().reason;
    EXPECT_LT(ate(o, o.online), 0.01 * air_ground_common::pathLength(o.truth));
    std::printf("round %d: %zu keyframes, %zu landmarks, ATE %.4f m\n", round, odometry.map().keyframeCount(),
                odometry.map().landmarkCount(), ate(o, o.online));
    if (round >= 2) {
      EXPECT_LE(odometry.map().keyframeCount(), keyframes + 2);
      EXPECT_LE(odometry.map().landmarkCount(), 1.1 * static_cast<double>(landmarks));
    }
    keyframes = odometry.map().keyframeCount();
    landmarks = odometry.map().landmarkCount();
  }
}

// A fast flight, or one over poor texture: each keyframe is placed by the one before while that one's adjustment is
// awaited, and so are the errors of their rotations, which grew threefold a keyframe until none was a rotation any
// more.
TEST(Odometry, ManyKeyframesOneAfterTheOtherStayPoses) {
  OdometrySettings settings;
  settings.synchronous = false;
  settings.reproducible = true;
  settings.keyframe_distance = 0.01;
  settings.keyframe_angle = 0.02;
  Options options;
  options.end = 6;
  const Outcome o = fly(options, settings);
  std::size_t keyframes = 0;
  for (const VoResult& r : o.frames) keyframes += r.keyframe;
  EXPECT_GT(keyframes, 50u);
  for (const VoResult& r : o.frames)
    EXPECT_LT((r.T_map_camera.linear() * r.T_map_camera.linear().transpose() - Eigen::Matrix3d::Identity()).norm(),
              1e-12);
  EXPECT_LT(shapeError(o), 0.01);
}

TEST(Odometry, RefusesWhatItCannotUse) {
  Odometry odometry(synthetic::camera(), synthetic::T_imu_camera(), Pose::Identity(), OdometrySettings{});
  EXPECT_THROW(odometry.process(0.1, cv::Mat(10, 10, CV_8UC1)), std::invalid_argument);
  EXPECT_THROW(odometry.process(0.2, cv::Mat(480, 752, CV_8UC3)), std::invalid_argument);
  odometry.process(1.0, cv::Mat(480, 752, CV_8UC1, cv::Scalar(5)));
  EXPECT_NE(odometry.process(0.9, cv::Mat(480, 752, CV_8UC1, cv::Scalar(5))).reason.find("stamp"), std::string::npos);
  EXPECT_FALSE(odometry.addImu({std::nan(""), {0, 0, 0}, {0, 0, 9.8}}));
  OdometrySettings bad;
  bad.window = 1;
  EXPECT_THROW(Odometry(synthetic::camera(), synthetic::T_imu_camera(), Pose::Identity(), bad), std::invalid_argument);
}

}  // namespace
