// The map's bookkeeping and the IMU helpers.
#include <gtest/gtest.h>

#include "synthetic.h"
#include "synthetic_map.h"
#include "visual_frontend/image_memory.h"
#include "visual_frontend/imu_attitude.h"
#include "visual_frontend/landmark_tracks.h"
#include "visual_frontend/map.h"
#include "visual_frontend/rolling_shutter.h"

namespace visual_frontend {
namespace {

using air_ground_common::expSO3;
using synthetic::keyframeSeeing;
using synthetic::Random;

TEST(Map, KeepsBothSidesConsistent) {
  Map map;
  std::vector<LandmarkId> l;
  for (int i = 0; i < 6; ++i) l.push_back(map.addLandmark(Eigen::Vector3d(i, 0, 0)));
  const KeyframeId a = map.addKeyframe(keyframeSeeing({l[0], l[1], l[2], kNoLandmark}));
  const KeyframeId b = map.addKeyframe(keyframeSeeing({l[1], l[2], l[3]}));
  const KeyframeId c = map.addKeyframe(keyframeSeeing({l[2], l[4]}));
  ASSERT_EQ(map.covisible(b).size(), 2u);
  EXPECT_EQ(map.covisible(b)[0].keyframe, a);
  EXPECT_EQ(map.covisible(b)[0].shared, 2);
  EXPECT_EQ(map.covisible(b, 2).size(), 1u);
  EXPECT_FALSE(map.connect(a, 3, l[1]));  // a sees it already
  EXPECT_TRUE(map.connect(a, 3, l[4]));
  EXPECT_EQ(map.covisible(c)[0].shared, 2);
  map.fuse(l[3], l[4]);
  EXPECT_FALSE(map.hasLandmark(l[4]));
  EXPECT_EQ(map.landmark(l[3]).observations.size(), 3u);
  EXPECT_EQ(map.keyframe(c).observations[1].landmark, l[3]);
  map.removeKeyframe(a);
  EXPECT_FALSE(map.hasLandmark(l[0]));  // nobody else saw it
  EXPECT_EQ(map.landmark(l[2]).observations.size(), 2u);
  map.removeLandmark(l[2]);
  EXPECT_EQ(map.keyframe(b).observations[1].landmark, kNoLandmark);
  EXPECT_THROW(map.connect(a, 0, l[1]), std::out_of_range);
  EXPECT_EQ(map.landmarksOf({b, c}), (std::vector<LandmarkId>{l[1], l[3]}));
}

TEST(Map, TransformMovesCamerasAndPointsTogether) {
  Random random(1);
  Map map;
  const LandmarkId id = map.addLandmark(random.vector(2));
  Keyframe k = keyframeSeeing({id});
  k.T_map_camera = synthetic::randomPose(random);
  k.observations[0].depth = 2;
  const KeyframeId key = map.addKeyframe(k);
  const Eigen::Vector3d before = map.keyframe(key).T_map_camera.inverse() * map.landmark(id).position;
  air_ground_common::Similarity S;
  S.scale = 1.7;
  S.R = expSO3(random.vector(1));
  S.t = random.vector(3);
  map.transform(S);
  const Eigen::Vector3d after = map.keyframe(key).T_map_camera.inverse() * map.landmark(id).position;
  EXPECT_LT((after - 1.7 * before).norm(), 1e-12);
  EXPECT_NEAR(map.keyframe(key).observations[0].depth, 3.4, 1e-12);
}

TEST(Map, ViewsDifferByDistanceOverDepthOrByAngle) {
  const Pose a = Pose::Identity(), b = air_ground_common::yawPose(0.1, {0.3, 0.4, 0});
  EXPECT_NEAR(changeOfView(a, b, 5, {0.1, 1}), 1, 1e-12);
  EXPECT_NEAR(changeOfView(a, b, 10, {0.1, 0.1}), 1, 1e-12);
  EXPECT_NEAR(changeOfView(b, a, 5, {0.2, 0.05}), 2, 1e-12);
  Map map;
  Keyframe k = keyframeSeeing({});
  EXPECT_FALSE(map.medianDepth(k));
  k = keyframeSeeing({map.addLandmark({0, 0, 2}), map.addLandmark({3, 0, 4}), map.addLandmark({0, 0, 9})});
  k.T_map_camera.translation().z() = 1;
  EXPECT_NEAR(*map.medianDepth(k), 3, 1e-12);
}

ImuSample imu(double stamp, const Eigen::Vector3d& rate, const Eigen::Vector3d& force) {
  ImuSample s;
  s.stamp = stamp;
  s.angular_velocity = rate;
  s.specific_force = force;
  return s;
}

TEST(Imu, IntegratesTheRotationOfATrajectory) {
  // R_world_imu(t) with a varying rate in the body frame; bias added.
  const Eigen::Vector3d bias(0.02, -0.01, 0.03);
  const auto rate = [](double t) {
    return Eigen::Vector3d(0.8 * std::sin(3 * t), 0.5 * std::cos(2 * t), 0.6 + 0.3 * t);
  };
  ImuBuffer buffer;
  for (int i = 0; i <= 400; ++i) buffer.add(imu(i * 0.005, rate(i * 0.005) + bias, {0, 0, 9.81}));
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  const double t0 = 0.3127, t1 = 1.4613;
  constexpr int kSteps = 20000;
  for (int i = 0; i < kSteps; ++i) R = R * expSO3(rate(t0 + (i + 0.5) * (t1 - t0) / kSteps) * (t1 - t0) / kSteps);
  const auto estimate = buffer.integrateRotation(t0, t1, bias);
  ASSERT_TRUE(estimate);
  EXPECT_LT(air_ground_common::rotationAngle(*estimate, R), 1e-4);
  EXPECT_GT(air_ground_common::rotationAngle(estimate->transpose(), R), 0.1);
  EXPECT_FALSE(buffer.integrateRotation(1.5, 2.5, bias));
  EXPECT_FALSE(buffer.add(imu(1.0, {0, 0, 0}, {0, 0, 9.81})));
  EXPECT_FALSE(buffer.add(imu(3.0, {NAN, 0, 0}, {0, 0, 9.81})));
}

// A byte of a message can be any on a bad line: one sample of 1e30 rad/s would else be in every later estimate.
TEST(Imu, SpoiltReadingsAreRefused) {
  const Eigen::Vector3d up(0, 0, 9.81);
  ImuBuffer buffer;
  ASSERT_TRUE(buffer.add(imu(0.000, {0.1, 0, 0}, up)));
  EXPECT_FALSE(buffer.add(imu(0.005, {1e30, 0, 0}, up)));
  EXPECT_FALSE(buffer.add(imu(0.005, {0, 200, 0}, up)));
  EXPECT_FALSE(buffer.add(imu(0.005, {0.1, 0, 0}, {0, -1e5, 0})));
  EXPECT_FALSE(buffer.add(imu(0.005, {0.1, 30, 0}, up))) << "leaps";
  EXPECT_FALSE(buffer.add(imu(0.010, {0.1, 0, 0}, {0, 150, 0}))) << "leaps";
  EXPECT_TRUE(buffer.add(imu(0.015, {0.2, 0, 0}, up)));
  EXPECT_TRUE(buffer.covers(0, 0.015));
}

TEST(Imu, AQuickTurnThatLastsIsBelieved) {
  ImuBuffer buffer;
  const auto rate = [](double t) { return t < 0.1 ? 0.0 : 20.0; };
  for (int i = 0; i <= 60; ++i) buffer.add(imu(i * 0.005, {0, 0, rate(i * 0.005)}, {0, 0, 9.81}));
  EXPECT_DOUBLE_EQ(buffer.samples().back().angular_velocity.z(), 20);
  EXPECT_TRUE(buffer.covers(0, 0.3));
  const auto R = buffer.integrateRotation(0, 0.3, Eigen::Vector3d::Zero());
  ASSERT_TRUE(R);
  EXPECT_NEAR(Eigen::AngleAxisd(*R).angle(), std::acos(std::cos(4.0)), 0.4);
}

TEST(Imu, GapsAreNotCovered) {
  ImuBuffer buffer;
  for (int i = 0; i < 100; ++i) {
    if (i < 40 || i > 60) buffer.add(imu(i * 0.005, {0, 0, 0}, {0, 0, 9.81}));
  }
  EXPECT_TRUE(buffer.covers(0.0, 0.19));
  EXPECT_FALSE(buffer.covers(0.1, 0.4));
}

/// What is said of the images between 100 and 105 s, at 20 Hz, each after all samples up to its stamp and one more.
std::string coverageOf(double rate, double stamps_ahead, double burst = 1e9) {
  ImuBuffer buffer;
  ImuCoverage coverage;
  double next = 98;
  for (int i = 1; i <= 100; ++i) {
    const double t = 100 + 0.05 * i;
    for (; buffer.empty() || buffer.samples().back().stamp < t + std::min(0.0, stamps_ahead); next += 1 / rate)
      if (std::fmod(next, burst) < 0.5 * burst) buffer.add(imu(next + stamps_ahead, {0, 0, 0.1}, {0, 0, 9.81}));
    coverage.add(buffer, t - 0.05, t);
  }
  return coverage.problem();
}

TEST(ImuCoverage, NamesWhatKeepsSamplesFromTheImages) {
  for (const double rate : {30.0, 100.0, 1000.0}) EXPECT_EQ(coverageOf(rate, 0), "") << rate;
  for (const double rate : {5.0, 10.0, 19.0})
    EXPECT_EQ(coverageOf(rate, 0).find("IMU at " + std::to_string(static_cast<int>(rate)) + " Hz"), 0u)
        << coverageOf(rate, 0);
  EXPECT_NE(coverageOf(200, -1000).find("s before the images'"), std::string::npos) << coverageOf(200, -1000);
  EXPECT_NE(coverageOf(200, 8).find("s ahead of the images': one clock"), std::string::npos) << coverageOf(200, 8);
  EXPECT_NE(coverageOf(200, 0, 0.14).find("with gaps of more than 0.05 s"), std::string::npos)
      << coverageOf(200, 0, 0.14);
}

TEST(ImuCoverage, AGapIsNoFaultAndOneThatIsOverIsForgotten) {
  ImuBuffer buffer;
  ImuCoverage coverage;
  const auto images = [&](double from, double to) {
    for (double t = from; t < to; t += 0.05) coverage.add(buffer, t, t + 0.05);
  };
  images(0, 5);
  EXPECT_EQ(coverage.problem(), "") << "there is no IMU";
  for (int i = 0; i <= 200; ++i) buffer.add(imu(i * 0.005, {0, 0, 0}, {0, 0, 9.81}));
  images(0, 1);
  images(2, 3);
  EXPECT_EQ(coverage.problem(), "");
  images(3, 5);
  EXPECT_NE(coverage.problem().find("before the images'"), std::string::npos) << coverage.problem();
  for (int i = 1000; i <= 2000; ++i) buffer.add(imu(i * 0.005, {0, 0, 0}, {0, 0, 9.81}));
  images(6, 9);
  EXPECT_EQ(coverage.problem(), "");
}

// The robot may be turned while its IMU is silent.
TEST(Attitude, OfBeforeAGapIsNone) {
  AttitudeFilter filter;
  const auto feed = [&](double from, double to, const Eigen::Vector3d& up) {
    for (double t = from; t <= to; t += 0.005) filter.add(imu(t, {0, 0, 0}, 9.81 * up));
  };
  const Eigen::Vector3d upright(0, 0, 1), leaning(std::sin(0.8), 0, std::cos(0.8));
  feed(0, 2, upright);
  ASSERT_TRUE(filter.atRest());
  EXPECT_TRUE(filter.knownAt(2.1));
  EXPECT_FALSE(filter.knownAt(2.6)) << "no sample tells of it";
  filter.add(imu(2.8, {0, 0, 0}, 9.81 * leaning));
  EXPECT_FALSE(filter.initialized() || filter.atRest() || filter.knownAt(2.8));
  feed(2.805, 2.9, leaning);
  ASSERT_TRUE(filter.knownAt(2.9));
  EXPECT_LT((filter.up() - leaning).norm(), 1e-6);
  EXPECT_GE(filter.upSigma(), 0.05) << "by a tenth of a second";
  EXPECT_FALSE(filter.atRest());
  feed(2.905, 4, leaning);
  EXPECT_TRUE(filter.atRest());
  EXPECT_LT((filter.up() - leaning).norm(), 1e-6);
}

TEST(ImageMemory, LargeImagesAreFewer) {
  const auto pyramid = [](int width, int height) {
    return std::vector<cv::Mat>{cv::Mat(height, width, CV_8U), cv::Mat(height / 2, width / 2, CV_8U)};
  };
  EXPECT_EQ(imagesKept(pyramid(640, 480), 300), 300);
  EXPECT_EQ(imagesKept(pyramid(752, 480), 300), 300);
  EXPECT_EQ(imagesKept(pyramid(1280, 960), 300), 300);
  EXPECT_EQ(imagesKept(pyramid(3840, 2160), 300), 57);  // 10.4 MB each
  EXPECT_EQ(imagesKept(pyramid(3840, 2160), 4), 4);
  EXPECT_EQ(imagesKept(pyramid(8000, 8000), 300), 10);
  EXPECT_EQ(imagesKept({}, 300), 300);
}

TEST(Attitude, RestGivesUpAndBiasThenFollowsRotation) {
  Random random(2);
  const Eigen::Matrix3d R_0 = expSO3(Eigen::Vector3d(0.2, -0.1, 0.5));  // R_world_imu
  const Eigen::Vector3d bias(0.01, 0.02, -0.015);
  AttitudeFilter filter;
  Eigen::Matrix3d R = R_0;
  double t = 0;
  for (; t < 2; t += 0.005)
    filter.add(imu(t, bias + random.gaussVector(0.003),
                   R.transpose() * Eigen::Vector3d(0, 0, 9.81) + random.gaussVector(0.03)));
  ASSERT_TRUE(filter.initialized() && filter.atRest() && filter.biasKnown());
  EXPECT_LT((filter.gyroBias() - bias).norm(), 0.002);
  EXPECT_LT((filter.up() - R.transpose().col(2)).norm(), 0.01);
  // Now it turns and shakes for ten seconds.
  for (; t < 12; t += 0.005) {
    const Eigen::Vector3d rate(0.4 * std::sin(t), 0.3 * std::cos(1.7 * t), 0.5);
    R = R * expSO3(rate * 0.005);
    const Eigen::Vector3d acceleration(0.5 * std::sin(4 * t), 0.4 * std::cos(5 * t), 0);
    filter.add(imu(t, rate + bias + random.gaussVector(0.003),
                   R.transpose() * (Eigen::Vector3d(0, 0, 9.81) + acceleration) + random.gaussVector(0.05)));
  }
  EXPECT_FALSE(filter.atRest());
  EXPECT_LT((filter.up() - R.transpose().col(2)).norm(), 0.03);
  EXPECT_LT(filter.upSigma(), 0.05);
  filter.reset();
  EXPECT_FALSE(filter.initialized());
}

TEST(RollingShutter, CarriesWhatARowSeesToTheMiddleRowAndBack) {
  const CameraModel camera = synthetic::camera();
  constexpr double kReadout = 0.03;
  const Eigen::Vector3d rate(0.8, -1.2, 0.6), velocity(0.5, -0.3, 0.4);
  RollingShutter rows(camera, kReadout);
  rows.setMotion(rate, velocity);
  Random random(4);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector2d seen(random.uniform(20, 620), random.uniform(20, 460));
    const double z = random.uniform(0.8, 5);
    // The camera's pose, in that of the middle row, when this row was exposed.
    const double t = ((seen.y() + 0.5) / camera.height - 0.5) * kReadout;
    Pose T_middle_row = Pose::Identity();
    T_middle_row.linear() = expSO3(rate * t);
    T_middle_row.translation() = velocity * t;
    const Eigen::Vector3d p_row = z * camera.unproject(seen).homogeneous(), p_middle = T_middle_row * p_row;
    EXPECT_LT((rows.pointToMiddleRow(seen.y(), p_row) - p_middle).norm(), 1e-4);
    EXPECT_LT((rows.toMiddleRow(seen, camera.unproject(seen), 1 / z) - p_middle.hnormalized()).norm() * camera.fx,
              0.01);
    const auto straight = camera.project(p_middle);
    ASSERT_TRUE(straight);
    EXPECT_LT((rows.toItsRow(*straight, p_middle) - seen).norm(), 0.05);
  }
  EXPECT_FALSE(RollingShutter(camera, 0).active());
  EXPECT_EQ(RollingShutter(camera, 0).toMiddleRow({3, 4}, {0.1, 0.2}, 1), Eigen::Vector2d(0.1, 0.2));
}

TEST(LandmarkTracks, AreOfALandmarkOrOfViewsAndEndWithTheirFeature) {
  LandmarkTracks tracks;
  EXPECT_EQ(tracks.landmarkOf(1), kNoLandmark);
  tracks.addView(1, {7, 0});
  tracks.addView(1, {8, 3});
  tracks.addView(2, {8, 4});
  tracks.assign(3, 30);
  tracks.assign(4, 40);
  EXPECT_EQ(tracks.count(), 2);
  EXPECT_EQ(tracks.viewsOf(1).size(), 2u);
  tracks.forgetKeyframe(8);
  ASSERT_EQ(tracks.viewsOf(1).size(), 1u);
  EXPECT_EQ(tracks.viewsOf(1)[0].keyframe, 7);
  EXPECT_TRUE(tracks.viewsOf(2).empty());
  tracks.assign(1, 10);  // placed: its views are the landmark's now
  EXPECT_TRUE(tracks.viewsOf(1).empty());
  EXPECT_EQ(tracks.landmarkOf(1), 10);
  tracks.replace(30, 31);
  EXPECT_EQ(tracks.landmarkOf(3), 31);
  Map map;
  while (map.landmarkCount() < 35) map.addLandmark(Eigen::Vector3d::Zero());
  EXPECT_EQ(tracks.landmarkOf(4), 40);
  EXPECT_EQ(tracks.landmarkIn(map, 4), kNoLandmark);
  EXPECT_EQ(tracks.landmarkIn(map, 3), 31);
  tracks.forgetMissing(map);
  EXPECT_FALSE(tracks.has(4));
  std::vector<Feature> features(1);
  features[0].id = 3;
  tracks.keep(features);
  EXPECT_TRUE(tracks.has(3));
  EXPECT_FALSE(tracks.has(1));
  tracks.release(3);
  EXPECT_EQ(tracks.count(), 0);
}

}  // namespace
TEST(Map, NamesTheKeyframeThatShowsAPlaceAgain) {
  // Cameras look down at a landmark 2 m below; nearer than 0.1 times that is the same place.
  const auto lookingDown = [](double x, double yaw, bool image) {
    Keyframe k;
    k.T_map_camera = Pose(Eigen::Translation3d(x, 0, 2) * Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) *
                          Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX()));
    k.observations.resize(1);
    if (image) k.pyramid.push_back(cv::Mat(8, 8, CV_8UC1));
    return k;
  };
  const auto redundant = [&](double x_early, bool early_image, double x_late, double yaw_late, bool late_image) {
    Map map;
    const LandmarkId landmark = map.addLandmark(Eigen::Vector3d(0, 0, 0));
    for (const Keyframe& k : {lookingDown(-3, 0, true), lookingDown(x_early, 0, early_image),
                              lookingDown(x_late, yaw_late, late_image), lookingDown(5, 0, true)})
      map.connect(map.addKeyframe(k), 0, landmark);
    return map.redundantKeyframe(1, {0.1, 0.25});
  };
  EXPECT_EQ(redundant(0, true, 0.19, 0, true), 2);
  EXPECT_EQ(redundant(0, true, 0.21, 0, true), kNoKeyframe);
  EXPECT_EQ(redundant(0, true, 0.1, 0.24, true), 2);
  EXPECT_EQ(redundant(0, true, 0.1, 0.26, true), kNoKeyframe);
  EXPECT_EQ(redundant(0, false, 0.1, 0, true), 1);  // the one that patches can be taken from stays
  EXPECT_EQ(redundant(0, true, -2.9, 0, true), 2);
  EXPECT_EQ(Map().redundantKeyframe(1, {0.1, 0.25}), kNoKeyframe);
}

}  // namespace visual_frontend
