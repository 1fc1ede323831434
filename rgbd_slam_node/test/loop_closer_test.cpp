// LoopCloser above a textured floor, whose depth is known.
#include "../src/loop_closer.h"

#include <gtest/gtest.h>

#include <memory>

#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using Outcome = LoopCloser::Outcome;
using simulated::synthetic::above;
using visual_frontend::Keyframe;
using visual_frontend::KeyframeCovariances;
using visual_frontend::Map;
using visual_frontend::Observation;
namespace synthetic = simulated::synthetic;

struct Place {
  double x, y;  ///< [m]
};

/// A way of keyframes, at first from (0, 0) far away and back, whose map has drifted by `drift` at the last one.
struct Loop {
  explicit Loop(const Eigen::Vector3d& drift_) : drift(drift_) {
    settings.loop_min_gap = 3;
    settings.loop_slack = 0.15;
    settings.loop_drift = 0.05;
  }
  void drive() {
    closer = std::make_unique<LoopCloser>(camera, settings);
    for (std::size_t i = 0; i < places.size(); ++i) {
      truth.push_back(above(places[i].x, places[i].y, height, 0.1 * static_cast<double>(i)));
      closer->moveTo(truth[i].translation());
      closer->add(add(static_cast<int>(i)));
    }
  }
  int last() const { return static_cast<int>(places.size()) - 1; }
  /// With a landmark for each of its ORB features, where the drifted map has it.
  KeyframeId add(int i) {
    cv::Mat depth;
    const cv::Mat gray = synthetic::renderPlane(camera, truth[i], texture, metres, &depth);
    Keyframe keyframe;
    keyframe.T_map_camera = truth[i];
    keyframe.T_map_camera.translation() += drift * i / last();
    visual_frontend::describeKeyframe(gray, camera, settings.place, keyframe);
    for (std::size_t k = 0; k < keyframe.orb_pixels.size(); ++k) {
      auto z = sampleDepth(depth, keyframe.orb_pixels[k], settings.depth);
      if (z) *z += random.gauss(depth_noise * settings.depth.sigma(*z));
      keyframe.orb_depth.push_back(z.value_or(0));
      Observation o;
      o.pixel = keyframe.orb_pixels[k];
      o.normalized = keyframe.orb_normalized[k];
      o.depth = z.value_or(0);
      if (z) o.landmark = map.addLandmark(keyframe.T_map_camera * (*z * o.normalized.homogeneous()));
      if (z && i == last()) tracks.assign(static_cast<TrackId>(k), o.landmark);
      keyframe.observations.push_back(o);
    }
    const KeyframeId id = map.addKeyframe(keyframe);
    if (step_sigma > 0) covariances.add(id, Matrix6d::Identity() * step_sigma * step_sigma / 9, map);
    return id;
  }
  Outcome close() {
    if (!closer) drive();
    return closer->close(last(), true, covariances, map, tracks);
  }
  double error(KeyframeId id) const {
    return (map.keyframe(id).T_map_camera.translation() - truth[id].translation()).norm();
  }
  /// Of the first and the last keyframe.
  int shared() const {
    for (const auto& c : map.covisible(last()))
      if (c.keyframe == 0) return c.shared;
    return 0;
  }
  /// The last keyframe sees what another has seen.
  void tieLastTo(KeyframeId other) {
    for (int k = 0; k < 20; ++k) {
      const LandmarkId landmark = map.addLandmark({1, 0.2, 0});
      for (const KeyframeId id : {other, KeyframeId(last())}) {
        auto& observations = map.keyframe(id).observations;
        observations.emplace_back();
        map.connect(id, static_cast<int>(observations.size()) - 1, landmark);
      }
    }
  }
  /// Points by which a keyframe's place is recognised in the last.
  int inliers(KeyframeId place) const {
    return visual_frontend::recognizePlace(map, camera, map.keyframe(last()), {place}, settings.place).inliers;
  }

  CameraModel camera = synthetic::camera(false);
  SlamSettings settings;
  cv::Mat texture = synthetic::texture(1800, 3);
  double metres = 9, height = 1.5;  ///< width of the texture, place of the camera [m]
  double depth_noise = 0;           ///< over DepthModel's
  double step_sigma = 0;            ///< by which each keyframe errs against the one before [m], [rad]; 0: not told
  std::vector<Place> places{{0, 0}, {1.2, 0.4}, {2.4, 1}, {1.2, 2}, {0, 0}};
  Eigen::Vector3d drift;
  synthetic::Random random{7};
  Map map;
  KeyframeCovariances covariances;
  visual_frontend::LandmarkTracks tracks;
  std::vector<Pose> truth;
  std::unique_ptr<LoopCloser> closer;
};

TEST(LoopCloser, TakesTheDriftOutOfTheWay) {
  Loop loop({0.2, -0.1, 0.05});
  ASSERT_EQ(loop.close(), Outcome::kCorrected);
  EXPECT_LT(loop.error(4), 0.02);
  EXPECT_LT(loop.error(2), 0.07) << "half of the drift was 0.11 m";
  EXPECT_EQ(loop.error(0), 0);
  EXPECT_GT(loop.shared(), 30);
  // What is tracked goes on with the landmarks that stayed.
  for (const LandmarkId id : loop.tracks.landmarks()) EXPECT_TRUE(loop.map.hasLandmark(id));
}

TEST(LoopCloser, RefusesACorrectionThatTheWayDoesNotExplain) {
  Loop loop({0.6, 0, 0});  // 0.15 m and 5 % of 6 m are 0.45 m
  EXPECT_EQ(loop.close(), Outcome::kRefused);
  EXPECT_NEAR(loop.error(4), 0.6, 1e-9);
  EXPECT_EQ(loop.shared(), 0);
}

TEST(LoopCloser, WhereTheMapIsKnownAnotherPlaceThatLooksAlikeIsNoLoop) {
  // 0.4 m are within 5 % of the way; but the camera sees what keyframe 1 has seen, 1.3 m from the place's.
  Loop loop({0.4, 0, 0});
  loop.drive();
  loop.tieLastTo(1);
  EXPECT_EQ(loop.close(), Outcome::kRefused);
  EXPECT_NEAR(loop.error(4), 0.4, 1e-9);
}

TEST(LoopCloser, AKeyframeThatReplacesAnotherStandsWhereThatOneWasReached) {
  // Of 6.5 m of way 0.3 m may be the drift, and of the 4.2 m to keyframe 3; not of the 1.3 m to keyframe 1.
  for (const bool replaced : {false, true}) {
    Loop loop({0.3, 0, 0});
    loop.drive();
    loop.tieLastTo(3);
    if (replaced) {
      loop.closer->replace(1, 3);
      loop.map.removeKeyframe(1);
    }
    EXPECT_EQ(loop.close(), replaced ? Outcome::kRefused : Outcome::kCorrected);
  }
}

TEST(LoopCloser, TheWayIsThatSinceAPlaceWasLastReached) {
  // Keyframe 3 has replaced the first one: its place was left 1.9 m ago, whose drift is no 0.35 m, as of 7 m it may be.
  Loop loop({0.7, 0, 0});
  loop.places = {{0.01, 0}, {1.2, 0.4}, {2.4, 1}, {0, 0}, {0.3, 0.6}, {0.6, 0}, {0, 0}};
  loop.drive();
  loop.closer->replace(0, 3);
  loop.map.removeKeyframe(0);
  EXPECT_EQ(loop.close(), Outcome::kRefused);
}

TEST(LoopCloser, TheNoiseOfACameraThatStandsIsNoWay) {
  Loop loop({0.3, 0, 0});
  loop.places = {{0, 0}, {0.8, 0}, {0.8, 0.3}, {0.4, 0.3}, {0, 0}};
  loop.drive();
  for (int i = 0; i < 2000; ++i) loop.closer->moveTo(loop.truth[4].translation() + loop.random.vector(0.014));
  loop.closer->add(4);
  EXPECT_EQ(loop.close(), Outcome::kRefused) << "2 m of way";
  // As far as the camera goes.
  for (int i = 0; i < 20; ++i)
    loop.closer->moveTo(loop.truth[4].translation() + Eigen::Vector3d(i % 2 ? 0.1 : 0, 0, 0));
  loop.closer->add(4);
  EXPECT_EQ(loop.close(), Outcome::kCorrected) << "4 m";
}

TEST(LoopCloser, OfAPoseThatIsRightOnlyTheLandmarksAreJoined) {
  Loop loop(Eigen::Vector3d::Zero());
  EXPECT_EQ(loop.close(), Outcome::kMerged);
  EXPECT_EQ(loop.error(4), 0);
  EXPECT_GT(loop.shared(), 30);
}

TEST(LoopCloser, TheNoiseOfFarDepthMovesNothing) {
  int worse = 0;
  for (const double x : {-0.6, -0.3, 0.3, 0.6}) {
    Loop loop(Eigen::Vector3d::Zero());
    loop.metres = 27;
    loop.height = 4.3;
    loop.depth_noise = 1;
    loop.settings.place.orb_features = 150;
    loop.places = {{0, 0}, {2.4, 0.8}, {4.8, 2}, {2.4, 4}, {x, 0.2}};
    loop.drive();
    const Outcome outcome = loop.close();
    EXPECT_NE(outcome, Outcome::kCorrected) << loop.error(4);
    worse += loop.error(4) > 1e-9;
  }
  EXPECT_EQ(worse, 0);
}

TEST(LoopCloser, ACorrectionBeyondWhatTheChainMayErrByNeedsMorePoints) {
  for (const double step_sigma : {0.002, 0.1}) {
    for (const bool many : {false, true}) {
      Loop loop({0.3, 0, 0});
      loop.step_sigma = step_sigma;
      loop.drive();
      const int inliers = loop.inliers(0);
      ASSERT_GT(inliers, 40);
      loop.settings.loop_min_inliers = many ? inliers / 2 : inliers / 2 + 2;
      LoopCloser strict(loop.camera, loop.settings);
      for (int i = 0; i < 5; ++i) {
        strict.moveTo(loop.truth[i].translation());
        strict.add(i);
      }
      EXPECT_EQ(strict.close(4, true, loop.covariances, loop.map, loop.tracks),
                many || step_sigma > 0.01 ? Outcome::kCorrected : Outcome::kRefused);
    }
  }
}

/// A floor of tiles that are all the same, seen from so near that a tile fills the image.
Loop amongTwins(const Eigen::Vector3d& drift) {
  Loop loop(drift);
  const cv::Mat tile = loop.texture(cv::Rect(0, 0, 300, 300)).clone();
  for (int v = 0; v < 6; ++v)
    for (int u = 0; u < 6; ++u) tile.copyTo(loop.texture(cv::Rect(300 * u, 300 * v, 300, 300)));
  loop.metres = 7.2;  // a tile is 1.2 m
  loop.height = 0.8;
  loop.settings.loop_slack = 0.8;
  return loop;
}

TEST(LoopCloser, OfTwoPlacesThatLookAlikeNoneIsTaken) {
  // Halfway between two that the camera may have come back to.
  Loop loop = amongTwins({0.55, 0, 0});
  loop.places = {{0, 0}, {1.2, 0}, {2.4, 1.4}, {1.2, 2.6}, {0.6, 2}, {0, 0}};
  EXPECT_EQ(loop.close(), Outcome::kRefused);
  EXPECT_NEAR(loop.error(5), 0.55, 1e-9);
}

TEST(LoopCloser, ATwinThatIsOutOfReachIsNoRival) {
  Loop loop = amongTwins({0.1, 0, 0});
  loop.settings.loop_slack = 0.5;
  loop.places = {{0, 0}, {1.26, 0.06}, {2.46, 1.46}, {1.2, 2.6}, {0.6, 2}, {0, 0}};
  loop.drive();
  ASSERT_GT(1.4 * loop.inliers(1), loop.inliers(0));
  EXPECT_EQ(loop.close(), Outcome::kCorrected);
  EXPECT_LT(loop.error(5), 0.02);
}

TEST(LoopCloser, PlacesJustLeftAreNoLoop) {
  Loop loop(Eigen::Vector3d::Zero());
  loop.drive();
  loop.settings.loop_min_gap = 5;
  EXPECT_EQ(LoopCloser(loop.camera, loop.settings).close(4, true, loop.covariances, loop.map, loop.tracks),
            Outcome::kNone);
}

}  // namespace
}  // namespace rgbd_slam
