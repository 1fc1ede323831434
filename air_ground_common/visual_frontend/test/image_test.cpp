// Tracking, re-observation and place recognition on rendered views of a textured plane.
#include <gtest/gtest.h>

#include <opencv2/features2d.hpp>

#include "../src/brightness.h"
#include "../src/hamming.h"
#include "textured_plane.h"
#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/place_recognition.h"
#include "visual_frontend/reobservation.h"

namespace visual_frontend {
namespace {

using synthetic::above;
using synthetic::kPlane;
using synthetic::onPlane;
using synthetic::planeMap;
using synthetic::planeTexture;
using synthetic::renderPlane;

TEST(Tracker, FollowsAMovingCameraToSubPixel) {
  const CameraModel camera = synthetic::camera();
  TrackerSettings settings;
  FeatureTracker tracker(camera, settings);
  tracker.track(renderPlane(camera, above(0, 0, 2), planeTexture(), kPlane));
  EXPECT_GT(tracker.replenish(), 150);
  EXPECT_LE(tracker.features().size(), static_cast<std::size_t>(settings.max_features));
  // Spread: every ninth of the image has its share.
  int ninth[9] = {};
  std::vector<std::pair<TrackId, Eigen::Vector3d>> truth;
  for (const Feature& f : tracker.features()) {
    ++ninth[std::min(2, static_cast<int>(f.pixel.x() / 214)) + 3 * std::min(2, static_cast<int>(f.pixel.y() / 160))];
    truth.emplace_back(f.id, onPlane(camera, above(0, 0, 2), f.pixel));
  }
  for (const int count : ninth) EXPECT_GT(count, 10);
  Pose T;
  for (int i = 1; i <= 6; ++i) {
    T = above(0.02 * i, -0.01 * i, 2 + 0.01 * i, 0.01 * i, 0.005 * i);
    tracker.track(renderPlane(camera, T, planeTexture(), kPlane));
  }
  std::vector<double> errors;
  for (const Feature& f : tracker.features()) {
    EXPECT_EQ(f.age, 6);
    for (const auto& [id, p] : truth) {
      if (id == f.id) errors.push_back((*camera.project(T.inverse() * p) - f.pixel).norm());
    }
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_GT(errors.size(), truth.size() * 3 / 4);
  EXPECT_LT(errors[errors.size() / 2], 0.25);
  EXPECT_LT(errors[errors.size() * 9 / 10], 0.8);
}

TEST(Tracker, FollowsThroughFlickeringLight) {
  const CameraModel camera = synthetic::camera();
  for (const double flicker : {0.0, 0.35}) {
    FeatureTracker tracker(camera, {});
    tracker.track(0.6 * renderPlane(camera, above(0, 0, 2), planeTexture(), kPlane));
    const int begun = tracker.replenish();
    std::vector<double> errors;
    std::vector<std::pair<TrackId, Eigen::Vector3d>> truth;
    for (const Feature& f : tracker.features()) truth.emplace_back(f.id, onPlane(camera, above(0, 0, 2), f.pixel));
    const Pose T = above(0.12, -0.06, 2);
    for (int i = 1; i <= 6; ++i)
      tracker.track(0.6 * (1 + (i % 2 ? flicker : -flicker)) *
                    renderPlane(camera, above(0.02 * i, -0.01 * i, 2), planeTexture(), kPlane));
    for (const Feature& f : tracker.features())
      for (const auto& [id, p] : truth)
        if (id == f.id) errors.push_back((*camera.project(T.inverse() * p) - f.pixel).norm());
    std::sort(errors.begin(), errors.end());
    ASSERT_GT(static_cast<int>(errors.size()), begun * 3 / 4) << "flicker " << flicker;
    EXPECT_LT(errors[errors.size() / 2], 0.25) << "flicker " << flicker;
  }
}

/// Light of a lamp that flickers, as a shutter shows it that exposes `period` rows while the lamp goes through once.
cv::Mat lampBands(int rows, double share, double period, double phase) {
  cv::Mat gain(rows, 1, CV_32F);
  for (int r = 0; r < rows; ++r)
    gain.at<float>(r) = static_cast<float>(1 + share * std::sin(2 * M_PI * (r / period + phase)));
  return gain;
}

TEST(Tracker, FollowsThroughBandsOfALamp) {
  const CameraModel camera = synthetic::camera();
  for (const double period : {160.0, 240.0}) {
    FeatureTracker tracker(camera, {});
    const auto image = [&](int i) {
      const cv::Mat plane = renderPlane(camera, above(0.02 * i, -0.01 * i, 2), planeTexture(), kPlane);
      return brightened(brightened(plane, cv::Mat(plane.rows, 1, CV_32F, cv::Scalar(0.6))),
                        lampBands(plane.rows, 0.3, period, 0.37 * i));
    };
    tracker.track(image(0));
    const int begun = tracker.replenish();
    std::vector<std::pair<TrackId, Eigen::Vector3d>> truth;
    for (const Feature& f : tracker.features()) truth.emplace_back(f.id, onPlane(camera, above(0, 0, 2), f.pixel));
    for (int i = 1; i <= 6; ++i) tracker.track(image(i));
    std::vector<double> errors;
    for (const Feature& f : tracker.features())
      for (const auto& [id, p] : truth)
        if (id == f.id) errors.push_back((*camera.project(above(0.12, -0.06, 2).inverse() * p) - f.pixel).norm());
    std::sort(errors.begin(), errors.end());
    ASSERT_GT(static_cast<int>(errors.size()), begun / 2) << "period " << period;
    EXPECT_LT(errors[errors.size() / 2], 0.3) << "period " << period;
  }
}

TEST(BrightnessLeap, IsTheWholeImagesNotAWindowsThatComesIntoView) {
  cv::Mat before(480, 752, CV_8U);
  cv::randu(before, 40, 120);
  const cv::Mat brighter = 1.3 * before, darker = 0.7 * before, alike = 1.05 * before;
  const auto expectAll = [](const cv::Mat& gains, double expected) {
    ASSERT_EQ(gains.size(), cv::Size(1, 480));
    EXPECT_LT(cv::norm(gains, cv::Mat(gains.size(), CV_32F, cv::Scalar(expected)), cv::NORM_INF), 0.02);
  };
  expectAll(brightnessLeap(before, brighter), 1.3);
  expectAll(brightnessLeap(before, darker), 0.7);
  EXPECT_TRUE(brightnessLeap(before, alike).empty());
  cv::Mat window = before.clone();
  window(cv::Rect(0, 0, 300, 480)) = 250;  // the mean is nearly twice as bright
  EXPECT_TRUE(brightnessLeap(before, window).empty());
  EXPECT_TRUE(brightnessLeap(cv::Mat::zeros(480, 752, CV_8U), before).empty()) << "of darkness nothing is known";
}

TEST(BrightnessLeap, FindsTheBandsOfALamp) {
  cv::Mat before(480, 752, CV_8U);
  cv::randu(before, 40, 120);
  const cv::Mat lamp = lampBands(480, 0.3, 200, 0.1), found = brightnessLeap(before, brightened(before, lamp));
  ASSERT_EQ(found.size(), lamp.size());
  EXPECT_LT(cv::norm(found, lamp, cv::NORM_INF), 0.06);
}

TEST(Tracker, RotationPriorBridgesFastTurns) {
  const CameraModel camera = synthetic::camera();
  const Pose T0 = above(0, 0, 2), T1 = above(0, 0, 2, 0.35);
  TrackPrediction right, wrong;
  right.R_current_previous = T1.linear().transpose() * T0.linear();
  wrong.R_current_previous = T0.linear().transpose() * T1.linear();
  std::size_t survivors[2];
  for (int i = 0; i < 2; ++i) {
    FeatureTracker tracker(camera, {});
    tracker.track(renderPlane(camera, T0, planeTexture(), kPlane));
    const double begun = tracker.replenish();
    tracker.track(renderPlane(camera, T1, planeTexture(), kPlane), i == 0 ? right : wrong);
    survivors[i] = tracker.features().size();
    EXPECT_NEAR(tracker.lastSurvival(), survivors[i] / begun, 1e-9);
  }
  EXPECT_GT(survivors[0], 80u);
  EXPECT_GT(survivors[0], 3 * survivors[1]);
}

TEST(Tracker, ReseededAndRemovedFeatures) {
  const CameraModel camera = synthetic::camera();
  FeatureTracker tracker(camera, {});
  EXPECT_EQ(tracker.addFeature({100, 100}), kNoTrack);  // no image yet
  tracker.track(renderPlane(camera, above(0, 0, 2), planeTexture(), kPlane));
  const TrackId id = tracker.addFeature({100, 100});
  ASSERT_NE(id, kNoTrack);
  EXPECT_EQ(tracker.addFeature({101, 100}), kNoTrack);
  EXPECT_EQ(tracker.addFeature({2, 100}), kNoTrack);
  tracker.remove({id});
  EXPECT_TRUE(tracker.features().empty());
  EXPECT_THROW(tracker.track(cv::Mat(10, 10, CV_8UC1)), std::invalid_argument);
  EXPECT_THROW(tracker.track(cv::Mat(480, 640, CV_8UC3)), std::invalid_argument);
  TrackerSettings bad;
  bad.window = 8;
  EXPECT_THROW(FeatureTracker(camera, bad), std::invalid_argument);
}

TEST(Tracker, DetectsWithBothDetectorsAndInsideTheMask) {
  const CameraModel camera = synthetic::camera();
  for (const CornerDetector detector : {CornerDetector::kFast, CornerDetector::kShiTomasi}) {
    TrackerSettings settings;
    settings.detector = detector;
    FeatureTracker tracker(camera, settings);
    tracker.track(renderPlane(camera, above(0, 0, 2), planeTexture(), kPlane));
    cv::Mat mask(480, 640, CV_8UC1, cv::Scalar(0));
    mask.colRange(0, 320) = 255;
    EXPECT_GT(tracker.replenish(mask), 50);
    for (const Feature& f : tracker.features()) EXPECT_LT(f.pixel.x(), 321);
  }
  FeatureTracker flat(camera, {});
  flat.track(cv::Mat(480, 640, CV_8UC1, cv::Scalar(90)));
  EXPECT_EQ(flat.replenish(), 0);
}

class ReobserveTest : public testing::TestWithParam<Pose> {};

TEST_P(ReobserveTest, FindsLandmarksFromAnotherPose) {
  const CameraModel camera = synthetic::camera();
  const Map map = planeMap(camera, above(0, 0, 2));
  const Pose T = GetParam();
  cv::Mat image = renderPlane(camera, T, planeTexture(), kPlane);
  image.convertTo(image, -1, 0.8, 15);  // another exposure
  Pose predicted = T;
  predicted.translation().x() += 0.012;  // some 3 px
  const auto matches = reobserve(map, camera, buildPyramid(image, 4), predicted, map.landmarkIds(), {}, {});
  std::vector<double> errors;
  for (const LandmarkMatch& m : matches)
    errors.push_back((*camera.project(T.inverse() * map.landmark(m.landmark).position) - m.pixel).norm());
  std::sort(errors.begin(), errors.end());
  ASSERT_GT(errors.size(), 40u);
  EXPECT_LT(errors[errors.size() / 2], 0.3);
  EXPECT_LT(errors[errors.size() * 95 / 100], 1.5);
}
INSTANTIATE_TEST_SUITE_P(Poses, ReobserveTest,
                         testing::Values(above(0.1, 0.05, 2), above(0.2, 0, 1.9, 0.8), above(0, 0.1, 1.4, -0.4),
                                         above(-0.1, 0, 2.9, 0.3), above(0, 0.3, 2, 0, 0.25)));

TEST(Reobserve, ClaimsLittleInAnotherScene) {
  const CameraModel camera = synthetic::camera();
  const Map map = planeMap(camera, above(0, 0, 2));
  // Turned, for the textures share a grid.
  const cv::Mat image = renderPlane(camera, above(0.4, 0.2, 2.3, 0.6), synthetic::texture(1600, 99), kPlane);
  EXPECT_LT(reobserve(map, camera, buildPyramid(image, 4), above(0, 0, 2), map.landmarkIds(), {}, {}).size(), 25u);
  // A pose that looks away sees nothing.
  EXPECT_TRUE(reobserve(map, camera, buildPyramid(image, 4), above(50, 0, 2), map.landmarkIds(), {}, {}).empty());
}

TEST(Place, RecognisesAndGivesTheRelativePose) {
  const CameraModel camera = synthetic::camera();
  const Pose T_place = above(0, 0, 2);
  const Map map = planeMap(camera, T_place);
  for (const bool query_depth : {false, true}) {
    const Pose T = above(0.25, -0.1, 2.2, 0.9, 0.1);
    cv::Mat depth;
    const cv::Mat image = renderPlane(camera, T, planeTexture(), kPlane, &depth);
    Keyframe query;
    describeKeyframe(image, camera, {}, query);
    Map used = map;
    if (query_depth) {  // depth only on the query's side: the inverse direction
      used.keyframe(0).orb_depth.clear();
      used.keyframe(0).observations.clear();
      for (const Eigen::Vector2d& p : query.orb_pixels)
        query.orb_depth.push_back(depth.at<float>(cvRound(p.y()), cvRound(p.x())));
    }
    const PlaceMatch match = recognizePlace(used, camera, query, {0}, {});
    ASSERT_TRUE(match.success) << match.reason << ", matches " << match.matches;
    const Pose truth = T_place.inverse() * T;
    EXPECT_LT((match.T_place_query.translation() - truth.translation()).norm(), 0.03);
    EXPECT_LT(air_ground_common::rotationAngle(match.T_place_query.linear(), truth.linear()), 0.012);
    EXPECT_EQ(match.landmarks.size() > 5, !query_depth);
  }
}

TEST(Place, RefusesAnotherScene) {
  const CameraModel camera = synthetic::camera();
  const Map map = planeMap(camera, above(0, 0, 2));
  Keyframe query;
  describeKeyframe(renderPlane(camera, above(0, 0, 2), synthetic::texture(1600, 99), kPlane), camera, {}, query);
  const PlaceMatch match = recognizePlace(map, camera, query, {0}, {});
  EXPECT_FALSE(match.success);
  EXPECT_FALSE(match.reason.empty());
}

TEST(Place, RelocalisesOnlyWhereItCanBe) {
  const CameraModel camera = synthetic::camera();
  const Pose T_place = above(0, 0, 2);
  Map map = planeMap(camera, T_place);
  // The same patch of floor three metres further on.
  const Eigen::Vector3d shift(3, 0, 0);
  Keyframe twin = map.keyframe(0);
  for (Observation& o : twin.observations) {
    if (o.landmark != kNoLandmark) o.landmark = map.addLandmark(map.landmark(o.landmark).position + shift);
  }
  twin.T_map_camera.translation() += shift;
  map.addKeyframe(twin);
  const Pose T = above(0.2, -0.1, 2.1, 0.4);
  Keyframe query;
  describeKeyframe(renderPlane(camera, T, planeTexture(), kPlane), camera, {}, query);

  RelocalizationGate gate;
  gate.T_map_last = T_place;
  const PlaceMatch anywhere = relocalize(map, camera, query, gate, {});
  EXPECT_FALSE(anywhere.success);
  EXPECT_NE(anywhere.reason.find("look alike"), std::string::npos) << anywhere.reason;
  for (const double x : {0.0, 3.0}) {
    gate.T_map_last.translation().x() = x;
    gate.max_distance = 1.0;
    const PlaceMatch match = relocalize(map, camera, query, gate, {});
    ASSERT_TRUE(match.success) << match.reason;
    const Pose found = map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
    EXPECT_LT((found.translation() - T.translation() - Eigen::Vector3d(x, 0, 0)).norm(), 0.03);
  }
  gate.T_map_last.translation().x() = 10;
  EXPECT_NE(relocalize(map, camera, query, gate, {}).reason.find("away"), std::string::npos);
  gate.T_map_last = T_place;
  const Eigen::Vector3d up = T.linear().transpose() * Eigen::Vector3d::UnitZ();
  gate.up_camera = up;
  EXPECT_TRUE(relocalize(map, camera, query, gate, {}).success);
  gate.max_distance = 10;
  gate.up_camera = Eigen::Vector3d(air_ground_common::expSO3(Eigen::Vector3d(0.3, 0, 0)) * up);
  EXPECT_NE(relocalize(map, camera, query, gate, {}).reason.find("gravity"), std::string::npos);
}

TEST(Place, TheGyroTellsTwinsApart) {
  const CameraModel camera = synthetic::camera();
  Map map = planeMap(camera, above(0, 0, 2));
  // The same patch of floor, three metres further on and turned about the vertical.
  const Pose shift(Eigen::Translation3d(3, 0, 0) * Eigen::AngleAxisd(1.2, Eigen::Vector3d::UnitZ()));
  Keyframe twin = map.keyframe(0);
  for (Observation& o : twin.observations) {
    if (o.landmark != kNoLandmark) o.landmark = map.addLandmark(shift * map.landmark(o.landmark).position);
  }
  twin.T_map_camera = shift * twin.T_map_camera;
  map.addKeyframe(twin);
  const Pose T = above(0.2, -0.1, 2.1, 0.4);
  Keyframe query;
  describeKeyframe(renderPlane(camera, T, planeTexture(), kPlane), camera, {}, query);

  RelocalizationGate gate;
  EXPECT_FALSE(relocalize(map, camera, query, gate, {}).success);
  const Eigen::Matrix3d drift = air_ground_common::expSO3(Eigen::Vector3d(0.03, -0.05, 0.08));
  for (const Pose& truth : {T, Pose(shift * T)}) {
    gate.R_map_camera = truth.linear() * drift;
    const PlaceMatch match = relocalize(map, camera, query, gate, {});
    ASSERT_TRUE(match.success) << match.reason;
    const Pose found = map.keyframe(match.keyframe).T_map_camera * match.T_place_query;
    EXPECT_LT((found.translation() - truth.translation()).norm(), 0.03);
    gate.R_map_camera = truth.linear() * Eigen::AngleAxisd(2.2, Eigen::Vector3d::UnitZ());
    EXPECT_NE(relocalize(map, camera, query, gate, {}).reason.find("gyro"), std::string::npos);
  }
}

TEST(Place, NeighboursOfOnePlaceDoNotHideItsTwin) {
  const CameraModel camera = synthetic::camera();
  Map map = planeMap(camera, above(0, 0, 2));
  const auto copy = [&](const Eigen::Vector3d& shift) {
    Keyframe keyframe = map.keyframe(0);
    for (Observation& o : keyframe.observations)
      if (o.landmark != kNoLandmark) o.landmark = map.addLandmark(map.landmark(o.landmark).position + shift);
    keyframe.T_map_camera.translation() += shift;
    return keyframe;
  };
  for (int k = 0; k < 10; ++k) map.addKeyframe(copy({0.01 * k, 0, 0}));
  const Pose T = above(0.2, -0.1, 2.1, 0.4);
  Keyframe query;
  describeKeyframe(renderPlane(camera, T, planeTexture(), kPlane), camera, {}, query);
  EXPECT_TRUE(relocalize(map, camera, query, {}, {}).success);
  map.addKeyframe(copy({3, 0, 0}));
  const PlaceMatch match = relocalize(map, camera, query, {}, {});
  EXPECT_FALSE(match.success);
  EXPECT_NE(match.reason.find("look alike"), std::string::npos) << match.reason;
}

TEST(Hamming, MatchesBitByBitCount) {
  cv::RNG rng(5);
  cv::Mat a(37, 32, CV_8U), b(53, 32, CV_8U);
  rng.fill(a, cv::RNG::UNIFORM, 0, 256);
  rng.fill(b, cv::RNG::UNIFORM, 0, 256);
  std::vector<int> nearest(a.rows), distance(a.rows), second(a.rows);
  nearestHamming(a.data, a.step, a.rows, b.data, b.step, b.rows, nearest.data(), distance.data(), second.data());
  for (int i = 0; i < a.rows; ++i) {
    std::vector<int> all;
    for (int j = 0; j < b.rows; ++j) {
      int d = 0;
      for (int k = 0; k < 32; ++k) {
        for (int bit = 0; bit < 8; ++bit) d += ((a.at<std::uint8_t>(i, k) ^ b.at<std::uint8_t>(j, k)) >> bit) & 1;
      }
      all.push_back(d);
    }
    EXPECT_EQ(all[nearest[i]], distance[i]);
    std::sort(all.begin(), all.end());
    EXPECT_EQ(all[0], distance[i]);
    EXPECT_EQ(all[1], second[i]);
  }
}

TEST(Hamming, MatchesAreTheMutualNearestThatPassTheRatio) {
  cv::RNG rng(7);
  cv::Mat a(200, 32, CV_8U), b(150, 32, CV_8U);
  rng.fill(a, cv::RNG::UNIFORM, 0, 256);
  rng.fill(b, cv::RNG::UNIFORM, 0, 256);
  for (int i = 0; i < 100; ++i) {  // of each, every second has its like in the other, twice now and then
    a.row(2 * i).copyTo(b.row(i));
    for (int k = 0; k < rng.uniform(0, 12); ++k) b.at<std::uint8_t>(i, rng.uniform(0, 32)) ^= 1 << rng.uniform(0, 8);
    if (i % 10 == 0) b.row(i).copyTo(b.row(100 + i / 10));
    if (i % 10 == 5) b.row(i).copyTo(a.row(2 * i + 1));
  }
  PlaceSettings settings;
  std::vector<std::vector<cv::DMatch>> forward;
  std::vector<cv::DMatch> back;
  cv::BFMatcher(cv::NORM_HAMMING).knnMatch(a, b, forward, 2);
  cv::BFMatcher(cv::NORM_HAMMING).match(b, a, back);
  std::vector<std::pair<int, int>> expected;
  for (const auto& m : forward)
    if (m[0].distance <= settings.max_hamming && m[0].distance <= settings.max_ratio * m[1].distance &&
        back[m[0].trainIdx].trainIdx == m[0].queryIdx)
      expected.emplace_back(m[0].queryIdx, m[0].trainIdx);
  EXPECT_GT(expected.size(), 70u);
  EXPECT_EQ(matchDescriptors(a, b, settings), expected);
}

}  // namespace
}  // namespace visual_frontend
