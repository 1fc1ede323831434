// DenseKeyframes, and what a readout time found late moves of them and of the keyframes: known points to known places.
#include "../src/shutter_alignment.h"

#include <gtest/gtest.h>

#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using simulated::synthetic::Random;
using visual_frontend::Keyframe;
using visual_frontend::kNoLandmark;
using visual_frontend::Map;
using visual_frontend::Observation;
using visual_frontend::RollingShutter;
namespace synthetic = simulated::synthetic;

/// A camera that goes and turns steadily, and is at T0 when the middle row of its image at time 0 is read.
struct Steady {
  Eigen::Vector3d velocity{0.4, -0.2, 0.3}, rate{0.3, 0.5, -0.2};  // in the map [m/s], [rad/s]
  Pose T0 = synthetic::randomPose(*std::make_unique<Random>(4));

  Pose at(double t) const {
    Pose T = T0;
    T.linear() = air_ground_common::expSO3(Eigen::Vector3d(t * rate)) * T.linear();
    T.translation() += t * velocity;
    return T;
  }
  /// Where a point is in the camera when its row is read.
  Eigen::Vector3d inItsRow(const CameraModel& camera, const Eigen::Vector3d& p_map, double readout_time) const {
    Eigen::Vector3d p = T0.inverse() * p_map;
    for (int round = 0; round < 6; ++round) {
      const double row = camera.project(p)->y();
      p = at(((row + 0.5) / camera.height - 0.5) * readout_time).inverse() * p_map;
    }
    return p;
  }
};

Frames around(const Steady& motion, double stamp, const Map& map) {
  Frames frames;
  for (int i = -2; i <= 2; ++i) frames.add(stamp + 0.1 * i, motion.at(0.1 * i), 0, map);
  return frames;
}

/// Points that the camera sees in all rows.
std::vector<Eigen::Vector3d> pointsBefore(const Pose& T_map_camera) {
  Random random(7);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 40; ++i) points.push_back(synthetic::visiblePoint(random, T_map_camera));
  return points;
}

TEST(MoveRows, WhatAKeyframeSawIsWhereItsMiddleRowSeesIt) {
  const CameraModel camera = synthetic::camera(false);
  const Steady motion;
  constexpr double kReadout = 0.03;
  const auto points = pointsBefore(motion.T0);
  Map map;
  Keyframe keyframe;
  keyframe.stamp = 10;
  keyframe.T_map_camera = motion.T0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d seen = motion.inItsRow(camera, points[i], kReadout);
    Observation o;
    o.landmark = map.addLandmark(points[i]);
    o.pixel = *camera.project(seen);
    o.normalized = seen.hnormalized();
    if (i % 2) o.depth = seen.z();
    keyframe.observations.push_back(o);
    keyframe.orb_pixels.push_back(o.pixel);
    keyframe.orb_normalized.push_back(o.normalized);
    keyframe.orb_depth.push_back(seen.z());
  }
  map.addKeyframe(keyframe);
  Keyframe strange = keyframe;  // of a time when no frame tells how the camera moved
  strange.stamp = 20;
  map.addKeyframe(strange);
  DenseKeyframes dense(camera, {});
  KeyframeSurfaces surfaces(camera, {});
  moveRows(kReadout, camera, around(motion, 10, map), map, dense, surfaces);
  double largest = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d p = motion.T0.inverse() * points[i];
    const Observation& o = map.keyframe(0).observations[i];
    largest = std::max(largest, (keyframe.observations[i].normalized - p.hnormalized()).norm());
    EXPECT_LT((o.normalized - p.hnormalized()).norm(), 1e-4) << i;
    EXPECT_NEAR(o.depth, i % 2 ? p.z() : 0, 2e-3) << i;
    EXPECT_LT((map.keyframe(0).orb_normalized[i] - p.hnormalized()).norm(), 1e-4) << i;
    EXPECT_NEAR(map.keyframe(0).orb_depth[i], p.z(), 2e-3) << i;
    EXPECT_EQ(map.keyframe(1).observations[i].normalized, keyframe.observations[i].normalized);
  }
  EXPECT_GT(largest, 5e-3) << "there is something to move";
}

TEST(MoveRows, DensePointsAreWhereTheMiddleRowSeesThem) {
  const CameraModel camera = synthetic::camera(false);
  Steady motion;
  motion.T0 = synthetic::above(0, 0, 1.5);
  constexpr double kReadout = 0.03;
  cv::Mat depth;
  const cv::Mat gray = synthetic::renderPlaneByRows(
      camera, [&](int row) { return motion.at(((row + 0.5) / camera.height - 0.5) * kReadout); },
      synthetic::texture(600, 3), 8, &depth);
  Map map;
  Keyframe keyframe;
  keyframe.stamp = 10;
  keyframe.T_map_camera = motion.T0;
  const KeyframeId id = map.addKeyframe(keyframe);
  DenseKeyframes dense(camera, {});
  dense.begin(id, 0, depth, gray, Pose::Identity(), RollingShutter(camera, 0));
  KeyframeSurfaces surfaces(camera, {});
  const auto heights = [&] {  // the floor's, in the map: zero [m]
    double largest = 0;
    const auto posed = dense.posed(map);
    for (const auto& point : *posed.at(0).points)
      largest = std::max(largest, std::abs((motion.T0 * point.position.cast<double>()).z()));
    return largest;
  };
  EXPECT_GT(heights(), 0.01);
  moveRows(kReadout, camera, around(motion, 10, map), map, dense, surfaces);
  EXPECT_LT(heights(), 1e-3);
}

/// A wall across the view, `z` away [m].
cv::Mat wall(const CameraModel& camera, float z) { return {camera.height, camera.width, CV_32F, cv::Scalar(z)}; }

double meanDepth(const PosedPoints& posed) {
  double sum = 0;
  for (const auto& point : *posed.points) sum += point.position.z();
  return sum / static_cast<double>(posed.points->size());
}

struct Dense : ::testing::Test {
  Dense() {
    settings.max_fused_frames = 3;
    settings.cloud.min_confirmations = 1;
    dense = std::make_unique<DenseKeyframes>(camera, settings);
    colour = cv::Mat(camera.height, camera.width, CV_8UC3, cv::Scalar(1, 2, 3));
    for (int i = 0; i < 2; ++i) {
      Keyframe keyframe;
      keyframe.T_map_camera.translation().x() = i;
      map.addKeyframe(keyframe);
    }
  }
  void begin(KeyframeId id, float z) { dense->begin(id, 0, wall(camera, z), colour, Pose::Identity(), rows); }
  void fuse(float z, const Pose& T_frame_keyframe = Pose::Identity()) {
    dense->fuse(wall(camera, z), T_frame_keyframe, rows);
  }

  CameraModel camera = synthetic::camera(false);
  SlamSettings settings;
  RollingShutter rows{camera, 0};
  cv::Mat colour;
  Map map;
  std::unique_ptr<DenseKeyframes> dense;
};

TEST_F(Dense, FramesRefineTheNewestUntilItIsFinished) {
  begin(0, 2.00f);
  ASSERT_EQ(dense->posed(map).size(), 1u);
  EXPECT_NEAR(meanDepth(dense->posed(map)[0]), 2.00, 1e-5);
  fuse(2.01f);
  EXPECT_NEAR(meanDepth(dense->posed(map)[0]), 2.005, 1e-4);
  Pose nearer = Pose::Identity();  // a frame 0.5 m closer to the wall
  nearer.translation().z() = -0.5;
  fuse(1.505f, nearer);
  EXPECT_NEAR(meanDepth(dense->posed(map)[0]), 2.005, 1e-4);
  dense->finish();
  fuse(2.02f);
  EXPECT_NEAR(meanDepth(dense->posed(map)[0]), 2.005, 1e-4) << "finished";
  begin(1, 3);
  fuse(3.01f);
  const auto both = dense->posed(map);
  ASSERT_EQ(both.size(), 2u);
  EXPECT_NEAR(meanDepth(both[0]), 2.005, 1e-4);
  EXPECT_EQ(both[1].keyframe, 1);
  EXPECT_EQ(both[1].T_map_camera.translation().x(), 1);
  EXPECT_NEAR(meanDepth(both[1]), 3.005, 1e-4);
  dense->forget(0);
  EXPECT_EQ(dense->posed(map).size(), 1u);
  dense->clear();
  EXPECT_TRUE(dense->posed(map).empty());
  begin(0, 2);
  begin(1, 3);
  EXPECT_EQ(dense->posed(map).size(), 2u) << "a newer one finishes the one before";
}

TEST_F(Dense, AFewFramesAreEnough) {
  begin(0, 2);
  for (int i = 0; i < 3; ++i) fuse(2.01f);
  EXPECT_NEAR(meanDepth(dense->posed(map)[0]), 2.0075, 1e-4);
  fuse(2.01f);
  EXPECT_NEAR(meanDepth(dense->posed(map)[0]), 2.0075, 1e-4);
}

/// Tracks on a floor that a swinging camera passes over, by a shutter of `readout` [s]; what `alignment` concludes.
std::optional<double> concluded(const SlamSettings& settings, double readout, double in_use) {
  const simulated::Robot robot;
  Random random(2);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 300; ++i) points.emplace_back(random.uniform(-3, 3), random.uniform(-3, 3), 0);
  ShutterAlignment alignment(robot.camera, settings);
  const auto cameraAt = [](double t) {
    return Pose(synthetic::above(0.4 * std::sin(0.6 * t), 0.2 * std::sin(1.3 * t), 1.5 + 0.2 * std::sin(0.5 * t)) *
                Pose(air_ground_common::expSO3({0.2 * std::sin(1.1 * t), 0.3 * std::sin(0.9 * t), 0})));
  };
  const cv::Mat gray(robot.camera.height, robot.camera.width, CV_8U, cv::Scalar(0));
  for (double t = 0; t < 12; t += 1.0 / 15) {
    cv::Mat depth = cv::Mat::zeros(gray.size(), CV_32F);
    std::vector<visual_frontend::Feature> features;
    for (std::size_t i = 0; i < points.size(); ++i) {
      std::optional<Eigen::Vector2d> pixel(Eigen::Vector2d(320, 239.5));
      Eigen::Vector3d p = Eigen::Vector3d::Zero();
      for (int round = 0; pixel && round < 5; ++round) {
        p = cameraAt(t + ((pixel->y() + 0.5) / robot.camera.height - 0.5) * readout).inverse() * points[i];
        pixel = robot.camera.project(p);
      }
      if (!pixel || !robot.camera.contains(*pixel, 5)) continue;
      cv::circle(depth, cv::Point2d(pixel->x(), pixel->y()), 3, cv::Scalar(p.z()), -1);
      visual_frontend::Feature f;
      f.id = static_cast<TrackId>(i);
      f.pixel = *pixel;
      f.normalized = p.hnormalized();
      features.push_back(f);
    }
    if (const auto found = alignment.add({t, gray, gray, depth}, cameraAt(t), features, in_use)) return found;
  }
  return std::nullopt;
}

TEST(ShutterAlignment, TellsOnlyOfAReadoutTimeThatIsSureAndAnother) {
  const SlamSettings settings;
  const auto found = concluded(settings, 0.03, 0);
  ASSERT_TRUE(found);
  EXPECT_NEAR(*found, 0.03, 0.005);
  EXPECT_FALSE(concluded(settings, 0.03, 0.03)) << "it is in use";
  EXPECT_FALSE(concluded(settings, 0, 0));
  SlamSettings exact;
  exact.readout_time_stddev = 0;
  EXPECT_FALSE(concluded(exact, 0.03, 0));
  EXPECT_EQ(ShutterAlignment(synthetic::camera(false), exact).stddev(), 0);
}

}  // namespace
}  // namespace rgbd_slam
