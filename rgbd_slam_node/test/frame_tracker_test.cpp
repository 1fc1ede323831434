// FrameTracker above a textured floor, whose depth is known, and before walls that show nothing.
#include "../src/frame_tracker.h"

#include <gtest/gtest.h>

#include <memory>

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
    reference.set(map, map.addKeyframe(keyframe));
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

/// In a room whose walls show nothing but their shape, with one keyframe where the robot stands at first.
struct InARoom : ::testing::Test {
  InARoom() {
    robot.walls = true;
    robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                                            air_ground_common::opticalFromForwardBody().transpose();
    settings.reobserve_every = 1;
  }
  /// With a landmark for each feature that has depth.
  void begin(const simulated::Robot::Frame& frame) {
    tracker = std::make_unique<FrameTracker>(robot.camera, settings, map, frames, tracks, surfaces, motion);
    tracker->restart(frame.gray);
    tracker->tracker().replenish();
    Keyframe keyframe;
    keyframe.T_map_camera = at(0);
    keyframe.pyramid = tracker->tracker().pyramid();
    keyframe.observations = tracker->observations(keyframe.T_map_camera, frame.depth);
    for (Observation& o : keyframe.observations) {
      if (!(o.depth > 0)) continue;
      o.landmark = map.addLandmark(keyframe.T_map_camera * (o.depth * o.normalized.homogeneous()));
      tracks.assign(o.track, o.landmark);
    }
    const KeyframeId id = map.addKeyframe(keyframe);
    for (std::size_t i = 0; i < keyframe.observations.size(); ++i)
      if (keyframe.observations[i].landmark != kNoLandmark)
        map.landmark(keyframe.observations[i].landmark).observations = {{id, static_cast<int>(i)}};
    surfaces.add(id, surfaces.surfaceOf(frame.depth, motion.rows()));
    reference.set(map, id);
    frames.add(0, keyframe.T_map_camera, id, map);
  }
  TrackedPose track(const simulated::Robot::Frame& frame, double stamp) {
    return tracker->track({stamp, frame.gray, frame.gray, frame.depth}, reference);
  }
  Pose at(double t) const { return robot.base(t) * robot.mounting.T_base_camera; }

  simulated::Robot robot;
  SlamSettings settings;
  Map map;
  Frames frames;
  visual_frontend::LandmarkTracks tracks;
  CameraMotion motion{robot.camera, Mounting(), settings};
  ReferenceKeyframe reference{settings};
  KeyframeSurfaces surfaces{robot.camera, settings};
  std::unique_ptr<FrameTracker> tracker;
};

TEST_F(InARoom, AFewLandmarksMoveNoPoseThatTheSurfacesFix) {
  begin(robot.render(0));
  std::vector<LandmarkId> few = map.landmarkIds();
  for (std::size_t i = 9; i < few.size(); ++i) map.removeLandmark(few[i]);
  few.resize(9);
  for (const LandmarkId id : few) map.landmark(id).position += at(0).linear() * Eigen::Vector3d(0.015, 0, 0);
  tracker->restart(cv::Mat(robot.camera.height, robot.camera.width, CV_8U, cv::Scalar(15)));
  const double t = robot.rest + 0.3;
  const TrackedPose found = track(robot.render(t), 0.3);
  ASSERT_TRUE(found.success) << found.reason;
  EXPECT_TRUE(found.by_depth);
  EXPECT_GE(found.landmarks, 5) << "found by their patches";
  EXPECT_LT((found.pose.T_map_camera.translation() - at(t).translation()).norm(), 0.005);
}

TEST_F(InARoom, ThePoseFollowsNobodyWhoWalksBeforeTheCamera) {
  // 0.9 m away, over most of the landmarks; by 23 mm to the right, and on.
  const auto withSomebody = [&](int shift) {
    simulated::Robot::Frame frame = robot.render(0);
    const cv::Rect place(120 + shift, 150, 330, 330);
    robot.texture(cv::Rect(300, 300, place.width, place.height)).copyTo(frame.gray(place));
    frame.depth(place) = 0.9f;
    return frame;
  };
  begin(withSomebody(0));
  int nearby = 0;
  for (const auto& entry : map.landmarks()) nearby += (at(0).inverse() * entry.second.position).z() < 1;
  ASSERT_GT(nearby, 0.55 * static_cast<double>(map.landmarkCount()));
  ASSERT_LT(nearby, 0.85 * static_cast<double>(map.landmarkCount()));
  for (int i = 1; i < 5; ++i) {
    const TrackedPose found = track(withSomebody(13 * i), 0.1 * i);
    ASSERT_TRUE(found.success) << found.reason;
    EXPECT_FALSE(found.by_depth);
    EXPECT_LT((found.pose.T_map_camera.translation() - at(0).translation()).norm(), 0.004) << i;
    EXPECT_LT(air_ground_common::rotationAngle(found.pose.T_map_camera.linear(), at(0).linear()), 0.003) << i;
  }
}

}  // namespace
}  // namespace rgbd_slam
