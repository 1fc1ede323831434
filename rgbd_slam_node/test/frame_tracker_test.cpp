// FrameTracker and LoopCloser above a textured floor, whose depth is known.
#include "../src/frame_tracker.h"

#include <gtest/gtest.h>

#include "../src/loop_closer.h"
#include "air_ground_common/statistics.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::synthetic::above;
using visual_frontend::Keyframe;
using visual_frontend::kNoLandmark;
using visual_frontend::Map;
using visual_frontend::Observation;
using visual_frontend::RollingShutter;
namespace synthetic = simulated::synthetic;

constexpr double kHeight = 1.5;  // [m]

struct Floor {
  CameraModel camera = synthetic::camera(false);
  cv::Mat texture = synthetic::texture(1800, 3);
  SlamSettings settings;

  struct Image {
    cv::Mat gray, depth;
  };
  Image see(const Pose& T) const {
    Image image;
    image.gray = synthetic::renderPlane(camera, T, texture, 9, &image.depth);
    return image;
  }
};

TEST(Observe, DepthIsThatOfTheMiddleRow) {
  const Floor floor;
  const cv::Mat depth(floor.camera.height, floor.camera.width, CV_32F, cv::Scalar(2));
  RollingShutter rows(floor.camera, 0.04);
  rows.setMotion(Eigen::Vector3d::Zero(), {0, 0, 0.5});
  const Eigen::Vector2d pixel(400, floor.camera.height - 0.5);  // half a readout later, 0.01 m nearer to it
  const Eigen::Vector2d normalized = floor.camera.unproject(pixel);
  const Observation late =
      observe({pixel.x(), floor.camera.height - 2.5}, normalized, depth, floor.settings.depth, rows);
  EXPECT_NEAR(late.depth, 2.01, 1e-4);
  EXPECT_NEAR(late.depth_sigma, floor.settings.depth.sigma(2), 1e-12);
  EXPECT_LT((late.normalized - normalized * 2 / 2.01).norm(), 1e-4);
  const Observation without =
      observe({400, 477}, normalized, cv::Mat::zeros(depth.size(), CV_32F), floor.settings.depth, rows, 1 / 2.0);
  EXPECT_EQ(without.depth, 0);
  EXPECT_LT((without.normalized - normalized * 2 / 2.01).norm(), 1e-4);
}

/// One keyframe at above(0, 0), with a landmark for each feature.
struct Tracked : ::testing::Test, Floor {
  Tracked() {
    const Image image = see(above(0, 0, kHeight));
    tracker.restart(image.gray);
    tracker.tracker().replenish();
    Keyframe keyframe;
    keyframe.T_map_camera = above(0, 0, kHeight);
    keyframe.pyramid = tracker.tracker().pyramid();
    keyframe.observations = tracker.observations(keyframe.T_map_camera, image.depth);
    for (Observation& o : keyframe.observations) {
      o.landmark = map.addLandmark(keyframe.T_map_camera * (o.depth * o.normalized.homogeneous()));
      tracks.assign(o.track, o.landmark);
    }
    reference.set(map.addKeyframe(keyframe));
    frames.add(0, keyframe.T_map_camera, reference.id(), map);
  }
  TrackedPose track(const Pose& T, double stamp) {
    const Image image = see(T);
    return tracker.track({stamp, image.gray, image.gray, image.depth}, reference);
  }
  static double error(const TrackedPose& found, const Pose& T) {
    return (found.pose.T_map_camera.translation() - T.translation()).norm();
  }

  Map map;
  Frames frames;
  visual_frontend::LandmarkTracks tracks;
  CameraMotion motion{camera, Mounting(), settings};
  ReferenceKeyframe reference{settings};
  KeyframeSurfaces surfaces{camera, settings};
  FrameTracker tracker{camera, settings, map, frames, tracks, surfaces, motion};
};

TEST_F(Tracked, LandmarksTellThePose) {
  const Pose T = above(0.05, -0.04, kHeight + 0.03, 0.04);
  const TrackedPose found = track(T, 0.1);
  ASSERT_TRUE(found.success) << found.reason;
  EXPECT_LT(error(found, T), 0.003);
  EXPECT_LT(air_ground_common::rotationAngle(found.pose.T_map_camera.linear(), T.linear()), 0.002);
  EXPECT_EQ(found.landmarks, tracks.count());
  EXPECT_GT(found.landmarks, 100);
}

TEST_F(Tracked, KeyframesKeepTheTracksFromDrifting) {
  settings.reobserve_every = 0;
  std::vector<std::optional<Eigen::Vector2d>> drifted;
  for (const auto& f : tracker.tracker().features()) drifted.emplace_back(f.pixel + Eigen::Vector2d(0.8, 0));
  tracker.tracker().move(drifted);
  const Pose T = above(0.03, -0.02, kHeight, 0.03);
  ASSERT_TRUE(track(T, 0.1).success);
  std::vector<double> pixels;
  for (const auto& f : tracker.tracker().features()) {
    const LandmarkId id = tracks.landmarkOf(f.id);
    if (id != kNoLandmark)
      pixels.push_back((*camera.project(T.inverse() * map.landmark(id).position) - f.pixel).norm());
  }
  ASSERT_GT(pixels.size(), 100u);
  EXPECT_LT(air_ground_common::median(pixels), 0.2);
}

TEST_F(Tracked, LandmarksThatDisagreeLoseTheirTracks) {
  settings.reobserve_every = 0;
  std::vector<LandmarkId> wrong = map.landmarkIds();
  wrong.resize(wrong.size() / 4);
  for (const LandmarkId id : wrong) map.landmark(id).position += Eigen::Vector3d(0.2, -0.1, 0);
  const Pose T = above(0.02, 0.02, kHeight);
  const TrackedPose found = track(T, 0.1);
  ASSERT_TRUE(found.success) << found.reason;
  EXPECT_LT(error(found, T), 0.003);
  for (const LandmarkId id : tracks.landmarks()) EXPECT_EQ(std::count(wrong.begin(), wrong.end(), id), 0);
}

TEST_F(Tracked, NoCameraMovesSoFast) {
  const Pose T = above(0.1, 0, kHeight);
  const TrackedPose found = track(T, 0.025);  // 4 m/s
  EXPECT_FALSE(found.success);
  EXPECT_NE(found.reason.find("m/s"), std::string::npos) << found.reason;
}

TEST_F(Tracked, AStrangeImageHasNoPose) {
  const TrackedPose found = track(above(3, 3, kHeight), 0.1);
  EXPECT_FALSE(found.success);
  EXPECT_NE(found.reason.find("agree on a pose"), std::string::npos) << found.reason;
}

TEST_F(Tracked, LostItIsFoundNearWhereItWasForHalfASecond) {
  const Pose T = above(0.03, 0.01, kHeight);
  const Image image = see(T);
  const auto find = [&](double stamp) {
    tracker.restart(image.gray);
    return tracker.findNearLast({stamp, image.gray, image.gray, image.depth});
  };
  EXPECT_FALSE(find(0.5).success);
  const TrackedPose found = find(0.4);
  ASSERT_TRUE(found.success) << found.reason;
  EXPECT_LT(error(found, T), 0.003);
  EXPECT_EQ(found.landmarks, static_cast<int>(tracker.tracker().features().size()));
}

TEST_F(Tracked, WithoutSuccessNoTrackIsLeft) {
  const Image image = see(above(2, 2, kHeight));
  tracker.restart(image.gray);
  tracker.tracker().replenish();
  ASSERT_FALSE(tracker.tracker().features().empty());
  const TrackedPose found = tracker.findAround(above(0, 0, kHeight), 10, {0.1, image.gray, image.gray, image.depth});
  EXPECT_FALSE(found.success);
  EXPECT_NE(found.reason, "");
  EXPECT_EQ(tracks.count(), 0);
  EXPECT_TRUE(tracker.tracker().features().empty());
}

/// A way of five keyframes from above(0, 0) far away and back, whose map has drifted by `drift` at the last one.
struct Loop : Floor {
  explicit Loop(const Eigen::Vector3d& drift_) : drift(drift_) {
    settings.loop_min_gap = 3;
    settings.loop_slack = 0.15;
    settings.loop_drift = 0.05;
    closer = std::make_unique<LoopCloser>(camera, settings);
    const double xs[] = {0, 1.2, 2.4, 1.2, 0};
    const double ys[] = {0, 0.4, 1.0, 2.0, 0};
    std::vector<LandmarkId> shared;
    for (int i = 0; i < 5; ++i) {
      truth.push_back(above(xs[i], ys[i], kHeight, 0.1 * i));
      if (i > 0) closer->advance((truth[i].translation() - truth[i - 1].translation()).norm());
      closer->add(add(i));
    }
  }
  /// With a landmark for each of its ORB features, where the drifted map has it.
  KeyframeId add(int i) {
    const Image image = see(truth[i]);
    Keyframe keyframe;
    keyframe.T_map_camera = truth[i];
    keyframe.T_map_camera.translation() += 0.25 * i * drift;
    visual_frontend::describeKeyframe(image.gray, camera, settings.place, keyframe);
    for (std::size_t k = 0; k < keyframe.orb_pixels.size(); ++k) {
      const auto z = sampleDepth(image.depth, keyframe.orb_pixels[k], settings.depth);
      keyframe.orb_depth.push_back(z.value_or(0));
      Observation o;
      o.pixel = keyframe.orb_pixels[k];
      o.normalized = keyframe.orb_normalized[k];
      o.depth = z.value_or(0);
      if (z) o.landmark = map.addLandmark(keyframe.T_map_camera * (*z * o.normalized.homogeneous()));
      if (z && i == 4) tracks.assign(static_cast<TrackId>(k), o.landmark);
      keyframe.observations.push_back(o);
    }
    return map.addKeyframe(keyframe);
  }
  LoopCloser::Outcome close() { return closer->close(4, true, map, tracks); }
  double error(KeyframeId id) const {
    return (map.keyframe(id).T_map_camera.translation() - truth[id].translation()).norm();
  }
  /// Of the first and the last keyframe.
  int shared() const {
    for (const auto& c : map.covisible(4))
      if (c.keyframe == 0) return c.shared;
    return 0;
  }

  Eigen::Vector3d drift;
  Map map;
  visual_frontend::LandmarkTracks tracks;
  std::vector<Pose> truth;
  std::unique_ptr<LoopCloser> closer;
};

TEST(LoopCloser, TakesTheDriftOutOfTheWay) {
  Loop loop({0.2, -0.1, 0.05});
  ASSERT_EQ(loop.close(), LoopCloser::Outcome::kCorrected);
  EXPECT_LT(loop.error(4), 0.02);
  EXPECT_LT(loop.error(2), 0.07) << "half of the drift was 0.11 m";
  EXPECT_EQ(loop.error(0), 0);
  EXPECT_GT(loop.shared(), 30);
  // What is tracked goes on with the landmarks that stayed.
  for (const LandmarkId id : loop.tracks.landmarks()) EXPECT_TRUE(loop.map.hasLandmark(id));
}

TEST(LoopCloser, RefusesACorrectionThatTheWayDoesNotExplain) {
  Loop loop({0.6, 0, 0});  // 0.15 m and 5 % of 6 m are 0.45 m
  EXPECT_EQ(loop.close(), LoopCloser::Outcome::kRefused);
  EXPECT_NEAR(loop.error(4), 0.6, 1e-9);
  EXPECT_EQ(loop.shared(), 0);
}

TEST(LoopCloser, WhereTheMapIsKnownAnotherPlaceThatLooksAlikeIsNoLoop) {
  // 0.4 m are within 5 % of the way; but the camera sees what keyframe 1 has seen, 1.3 m from the place's.
  Loop loop({0.4, 0, 0});
  for (int k = 0; k < 20; ++k) {
    const LandmarkId landmark = loop.map.addLandmark({1, 0.2, 0});
    for (const KeyframeId id : {KeyframeId(1), KeyframeId(4)}) {
      auto& observations = loop.map.keyframe(id).observations;
      observations.emplace_back();
      loop.map.connect(id, static_cast<int>(observations.size()) - 1, landmark);
    }
  }
  EXPECT_EQ(loop.close(), LoopCloser::Outcome::kRefused);
  EXPECT_NEAR(loop.error(4), 0.4, 1e-9);
}

TEST(LoopCloser, OfAPoseThatIsRightOnlyTheLandmarksAreJoined) {
  Loop loop(Eigen::Vector3d::Zero());
  EXPECT_EQ(loop.close(), LoopCloser::Outcome::kMerged);
  EXPECT_EQ(loop.error(4), 0);
  EXPECT_GT(loop.shared(), 30);
}

TEST(LoopCloser, PlacesJustLeftAreNoLoop) {
  Loop loop(Eigen::Vector3d::Zero());
  loop.settings.loop_min_gap = 5;
  EXPECT_EQ(LoopCloser(loop.camera, loop.settings).close(4, true, loop.map, loop.tracks), LoopCloser::Outcome::kNone);
}

}  // namespace
}  // namespace rgbd_slam
