// Tracks that have drifted, on rendered views of a textured plane.
#include <gtest/gtest.h>

#include "air_ground_common/statistics.h"
#include "textured_plane.h"
#include "visual_frontend/realignment.h"

namespace visual_frontend {
namespace {

using air_ground_common::quantile;
using synthetic::above;
using synthetic::onPlane;
using synthetic::planeMap;
using synthetic::Random;

cv::Mat viewOf(const Pose& T) {
  return synthetic::renderPlane(synthetic::camera(), T, synthetic::planeTexture(), synthetic::kPlane);
}

/// Tracks of a map's landmarks that are `drift` [px] beside where `T` sees them.
struct DriftedTracks {
  const CameraModel camera = synthetic::camera();
  FeatureTracker tracker{camera, {}};
  LandmarkTracks tracks;
  std::vector<Eigen::Vector2d> truth;  // of the tracker's features

  DriftedTracks(const Map& map, const Pose& T, const cv::Mat& image, double drift) {
    Random random(3);
    tracker.track(image);
    truth = synthetic::trackLandmarks(map, T, &tracker, &tracks);
    std::vector<std::optional<Eigen::Vector2d>> drifted;
    for (const Eigen::Vector2d& pixel : truth) {
      const double angle = random.uniform(0, 2 * M_PI);
      drifted.emplace_back(pixel + drift * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
    }
    tracker.move(drifted);
  }
  std::vector<double> errors() const {
    std::vector<double> errors;
    for (std::size_t i = 0; i < truth.size(); ++i) errors.push_back((tracker.features()[i].pixel - truth[i]).norm());
    return errors;
  }
};

class RealignTest : public testing::TestWithParam<Pose> {};

TEST_P(RealignTest, PutsTracksBackWhereTheirLandmarksAre) {
  const CameraModel camera = synthetic::camera();
  const Map map = planeMap(camera, above(0, 0, 2));
  const Pose T = GetParam();
  cv::Mat image = viewOf(T);
  image.convertTo(image, -1, 0.8, 15);  // another exposure
  DriftedTracks drifted(map, T, image, 0.8);
  ASSERT_GT(drifted.truth.size(), 60u);
  Pose predicted = T;
  predicted.translation().x() += 0.012;  // some 3 px
  const int aligned = realignTracks(map, drifted.tracks, predicted, 0, {}, &drifted.tracker);
  EXPECT_GT(aligned, static_cast<int>(0.8 * drifted.truth.size()));
  EXPECT_LT(quantile(drifted.errors(), 0.5), 0.15);
  EXPECT_LT(quantile(drifted.errors(), 0.75), 0.3);
  for (const Feature& f : drifted.tracker.features())
    EXPECT_LT((f.normalized - camera.unproject(f.pixel)).norm(), 1e-12);
}
INSTANTIATE_TEST_SUITE_P(Poses, RealignTest,
                         testing::Values(above(0.1, 0.05, 2), above(0.1, 0, 1.9, 0.8), above(0, 0.1, 1.6, -0.4),
                                         above(-0.1, 0, 2.5, 0.3), above(0, 0.3, 2, 0, 0.2)));

TEST(Realign, LeavesTracksWhoseViewHasChanged) {
  const Map map = planeMap(synthetic::camera(), above(0, 0, 2));
  const Pose near = above(0.1, 0, 2), far = above(0, 1.4, 2, 0, -0.6), low = above(0, 0, 1.1);
  const cv::Mat other = synthetic::renderPlane(synthetic::camera(), above(0.4, 0.2, 2.3, 0.6),
                                               synthetic::texture(1600, 99), synthetic::kPlane);
  for (const auto& [T, image] : {std::pair(near, other), std::pair(far, viewOf(far)), std::pair(low, viewOf(low))}) {
    DriftedTracks drifted(map, T, image, 0.8);
    ASSERT_GT(drifted.truth.size(), 15u);
    EXPECT_LT(realignTracks(map, drifted.tracks, T, 0, {}, &drifted.tracker),
              static_cast<int>(0.1 * drifted.truth.size()));
    EXPECT_NEAR(quantile(drifted.errors(), 0.5), 0.8, 1e-6);
  }
}

TEST(Realign, AlignsPointsThatAreNotPlacedYet) {
  const Map map = planeMap(synthetic::camera(), above(0, 0, 2));
  const Pose T = above(0.15, 0.05, 2, 0.5);
  DriftedTracks drifted(map, T, viewOf(T), 0.8);
  LandmarkTracks unplaced;
  for (const Feature& f : drifted.tracker.features())
    unplaced.setViews(f.id, map.landmark(drifted.tracks.landmarkOf(f.id)).observations);
  EXPECT_GT(realignTracks(map, unplaced, T, 2, {}, &drifted.tracker), static_cast<int>(0.8 * drifted.truth.size()));
  EXPECT_LT(quantile(drifted.errors(), 0.5), 0.15);
}

/// Errors of tracks that a noisy camera has followed for three seconds in a curve.
std::vector<double> errorsAfterFlight(bool realign) {
  const CameraModel camera = synthetic::camera();
  Map map = planeMap(camera, above(0, 0, 2));
  FeatureTracker tracker(camera, {});
  LandmarkTracks tracks;
  tracker.track(viewOf(above(0, 0, 2)));
  synthetic::trackLandmarks(map, above(0, 0, 2), &tracker, &tracks);
  cv::RNG rng(5);
  Pose T;
  for (int i = 1; i <= 60; ++i) {
    const double way = i / 60.0;
    T = above(0.4 * std::sin(way), 0.3 * (1 - std::cos(2 * way)), 2 - 0.3 * way, 0.8 * way, 0.05 * way);
    cv::Mat noise(camera.height, camera.width, CV_16S), image;
    rng.fill(noise, cv::RNG::NORMAL, 0, 4);
    viewOf(T).convertTo(image, CV_16S);
    cv::Mat(image + noise).convertTo(image, CV_8U);
    tracker.track(image);
    if (realign) realignTracks(map, tracks, T, 0, {}, &tracker);
  }
  std::vector<double> errors;
  for (const Feature& f : tracker.features())
    errors.push_back((*camera.project(T.inverse() * map.landmark(tracks.landmarkOf(f.id)).position) - f.pixel).norm());
  return errors;
}

TEST(Realign, KeepsTracksFromDrifting) {
  const auto drifted = errorsAfterFlight(false), kept = errorsAfterFlight(true);
  ASSERT_GT(kept.size(), 60u);
  EXPECT_GE(kept.size(), drifted.size() * 9 / 10);
  EXPECT_LT(quantile(kept, 0.5), 0.12);
  EXPECT_LT(quantile(kept, 0.5), 0.4 * quantile(drifted, 0.5));
}

TEST(Tracker, MovesFeaturesInTheirOrder) {
  FeatureTracker tracker(synthetic::camera(), {});
  tracker.track(viewOf(above(0, 0, 2)));
  const TrackId first = tracker.addFeature({100, 100}), second = tracker.addFeature({200, 100});
  tracker.move({std::nullopt, Eigen::Vector2d(201, 102)});
  ASSERT_EQ(tracker.features().size(), 2u);
  EXPECT_EQ(tracker.features()[0].id, first);
  EXPECT_EQ(tracker.features()[0].pixel, Eigen::Vector2d(100, 100));
  EXPECT_EQ(tracker.features()[1].id, second);
  EXPECT_EQ(tracker.features()[1].pixel, Eigen::Vector2d(201, 102));
  EXPECT_THROW(tracker.move({std::nullopt}), std::invalid_argument);
}

}  // namespace
}  // namespace visual_frontend
