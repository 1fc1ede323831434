#include "visual_frontend/local_landmarks.h"

#include <gtest/gtest.h>

#include "synthetic.h"

namespace visual_frontend {
namespace {

/// Two keyframes 1 m apart along x; of each point a track that both see.
struct Pair {
  explicit Pair(const std::vector<Eigen::Vector3d>& points) {
    for (int k = 0; k < 2; ++k) {
      Keyframe keyframe;
      keyframe.T_map_camera.translation().x() = k;
      for (std::size_t i = 0; i < points.size(); ++i) {
        Observation o;
        o.track = static_cast<TrackId>(i);
        o.normalized = (points[i] - keyframe.T_map_camera.translation()).hnormalized();
        keyframe.observations.push_back(o);
      }
      tracks.addViews(map.keyframe(map.addKeyframe(keyframe)));
    }
  }
  std::vector<UnplacedTrack> create(KeyframeId id) {
    return createLandmarks(id, synthetic::camera(), 1.0, {}, map, tracks);
  }
  Map map;
  LandmarkTracks tracks;
};

TEST(CreateLandmarks, PlacesWhatItsViewsFix) {
  Pair pair({{0.5, 0.2, 4}, {0, 0, 5000}, {0.3, -0.4, 3}, {0.1, 0.1, 2}});
  pair.map.keyframe(1).observations[2].normalized.y() += 0.1;
  pair.map.keyframe(1).observations[3].landmark = pair.map.addLandmark({7, 7, 7});
  const auto unplaced = pair.create(1);
  ASSERT_EQ(pair.tracks.count(), 1);
  const Landmark& landmark = pair.map.landmark(pair.tracks.landmarkOf(0));
  EXPECT_LT((landmark.position - Eigen::Vector3d(0.5, 0.2, 4)).norm(), 1e-6);
  EXPECT_GT(landmark.covariance.trace(), 0);
  EXPECT_EQ(landmark.observations.size(), 2u);
  EXPECT_EQ(pair.map.keyframe(0).observations[0].landmark, landmark.id);
  EXPECT_TRUE(pair.tracks.viewsOf(0).empty());
  ASSERT_EQ(unplaced.size(), 2u);
  EXPECT_EQ(unplaced[0].status, TriangulationStatus::kLowParallax);
  EXPECT_EQ(unplaced[1].track, 2);
  EXPECT_EQ(unplaced[1].observation, 2);
  EXPECT_EQ(unplaced[1].status, TriangulationStatus::kLargeResidual);
  EXPECT_EQ(pair.tracks.viewsOf(1).size(), 2u);  // a later view may do
}

TEST(CreateLandmarks, OneViewIsEnoughWithDepth) {
  Pair pair({{0.5, 0.2, 4}});
  pair.tracks.setViews(0, {{0, 0}});
  EXPECT_EQ(pair.create(0)[0].status, TriangulationStatus::kTooFewViews);
  pair.map.keyframe(0).observations[0].depth = 4;
  pair.map.keyframe(0).observations[0].depth_sigma = 0.01;
  EXPECT_TRUE(pair.create(0).empty());
  EXPECT_LT((pair.map.landmark(pair.tracks.landmarkOf(0)).position - Eigen::Vector3d(0.5, 0.2, 4)).norm(), 1e-6);
}

TEST(UntrackedLandmarks, AreThoseOfTheNearestKeyframesThatNoFeatureTracks) {
  Pair pair({{0.5, 0.2, 4}, {0.3, -0.4, 3}, {0.2, 0.3, 3.5}});
  ASSERT_TRUE(pair.create(1).empty());
  Keyframe far;
  far.T_map_camera.translation().x() = 50;
  far.observations.push_back({pair.map.addLandmark({50, 0, 3})});
  pair.map.addKeyframe(far);
  std::vector<Feature> features(2);
  features[0].id = 1;
  features[1].id = 99;  // without landmark
  const auto untracked = untrackedLandmarks(pair.map, pair.tracks, features, Pose::Identity(), 2);
  EXPECT_EQ(untracked, (std::vector<LandmarkId>{pair.tracks.landmarkOf(0), pair.tracks.landmarkOf(2)}));
  EXPECT_EQ(untrackedLandmarks(pair.map, pair.tracks, {}, Pose::Identity(), 3).size(), 4u);
}

}  // namespace
}  // namespace visual_frontend
