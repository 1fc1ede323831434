#include "visual_frontend/bundle_job.h"

#include <gtest/gtest.h>

#include "synthetic.h"

namespace visual_frontend {
namespace {

/// Keyframes 1 m apart along x that look along z and all see three landmarks.
Map row(int keyframes) {
  Map map;
  for (int i = 0; i < 3; ++i) map.addLandmark({1.0 * i, 0.5 * i, 5});
  for (int k = 0; k < keyframes; ++k) {
    Keyframe keyframe;
    keyframe.T_map_camera.translation() = Eigen::Vector3d(k, 0, 0);
    for (LandmarkId id = 0; id < 3; ++id) {
      Observation o;
      o.landmark = id;
      o.normalized = (map.landmark(id).position - keyframe.T_map_camera.translation()).hnormalized();
      keyframe.observations.push_back(o);
    }
    map.addKeyframe(keyframe);
  }
  return map;
}

TEST(BundleJob, TakesFixedKeyframesFirstAndWhatTwoOfThemSee) {
  Map map = row(4);
  const LandmarkId lonely = map.addLandmark({0, 0, 3});
  map.keyframe(3).observations.resize(4);
  map.connect(3, 3, lonely);
  BundleSettings settings;
  BundleJob job = extractBundle(map, synthetic::camera(), {2, 3}, {0}, settings);
  EXPECT_EQ(job.keyframes, (std::vector<KeyframeId>{0, 2, 3}));
  EXPECT_TRUE(job.problem.cameras[0].fixed);
  EXPECT_FALSE(job.problem.cameras[1].fixed);
  EXPECT_EQ(job.landmarks, (std::vector<LandmarkId>{0, 1, 2}));
  EXPECT_EQ(job.problem.measurements.size(), 9u);
  map.keyframe(3).observations[3].depth = 3;  // tells where it is
  EXPECT_EQ(extractBundle(map, synthetic::camera(), {2, 3}, {0}, settings).landmarks.size(), 4u);
  settings.use_depth = false;
  EXPECT_EQ(extractBundle(map, synthetic::camera(), {2, 3}, {0}, settings).landmarks.size(), 3u);
  EXPECT_TRUE(extractBundle(map, synthetic::camera(), {2, 3}, {}, settings).problem.cameras[0].fixed);
  EXPECT_THROW(extractBundle(map, synthetic::camera(), {9}, {}, settings), std::out_of_range);
}

TEST(BundleJob, LinksNeighboursOfTheMapAndHoldsOnlyWhatNothingElseDoes) {
  Map map = row(4);
  InertialMap inertial;
  inertial.metric = true;
  for (KeyframeId id = 1; id < 4; ++id) inertial.links.emplace(id, Preintegration(ImuNoise(), ImuBias()));
  inertial.states[1].velocity.x() = 7;
  const auto extract = [&](const std::vector<KeyframeId>& free, const std::vector<KeyframeId>& fixed) {
    return extractBundle(map, synthetic::camera(), free, fixed, {}, &inertial).problem;
  };
  const BundleProblem window = extract({1, 3}, {0});  // 3 follows 2, which is not in it
  ASSERT_EQ(window.links.size(), 1u);
  EXPECT_EQ(window.links[0].camera_a, 0);
  EXPECT_EQ(window.links[0].camera_b, 1);
  EXPECT_EQ(window.cameras[1].state.velocity.x(), 7);
  EXPECT_EQ(window.anchor, -1);
  EXPECT_TRUE(extract({3}, {0, 1}).links.empty());  // both ends held
  EXPECT_EQ(extract({0, 1}, {}).anchor, 0);
  EXPECT_FALSE(extract({0, 1}, {}).cameras[0].fixed);
  inertial.metric = false;
  EXPECT_TRUE(extract({0, 1}, {}).cameras[0].fixed);
  EXPECT_FALSE(extract({0, 1}, {}).cameras[0].state_fixed);
  map.keyframe(0).up_camera = Eigen::Vector3d::UnitY();
  EXPECT_FALSE(extract({0, 1}, {}).cameras[0].fixed);
}

TEST(BundleJob, CarriesAlongWhatCameMeanwhile) {
  Map map = row(3);
  InertialMap inertial;
  BundleJob job = extractBundle(map, synthetic::camera(), {1, 2}, {0}, {}, &inertial);
  // A quarter turn about z, and 1 m up, was found for the newest.
  Pose correction = air_ground_common::yawPose(M_PI / 2, {0, 0, 1});
  job.problem.cameras[2].T_map_camera = correction * job.problem.cameras[2].T_map_camera;
  job.problem.points[1] = {9, 9, 9};
  job.problem.cameras[1].state.velocity = {1, 2, 3};
  job.result.usable = true;
  Keyframe late;
  late.T_map_camera.translation() = Eigen::Vector3d(3, 0, 0);
  const KeyframeId id = map.addKeyframe(late);
  inertial.states[id].velocity = {1, 0, 0};
  const LandmarkId landmark = map.addLandmark({2, 0, 0});
  map.removeKeyframe(1);
  applyBundle(job, map, &inertial);
  EXPECT_TRUE(map.keyframe(id).T_map_camera.translation().isApprox(Eigen::Vector3d(0, 3, 1)));
  EXPECT_TRUE(map.landmark(landmark).position.isApprox(Eigen::Vector3d(0, 2, 1)));
  EXPECT_TRUE(inertial.states[id].velocity.isApprox(Eigen::Vector3d(0, 1, 0)));
  EXPECT_EQ(map.landmark(1).position, Eigen::Vector3d(9, 9, 9));
  EXPECT_EQ(map.keyframe(0).T_map_camera.translation(), Eigen::Vector3d::Zero());
  EXPECT_EQ(inertial.states.count(0), 0u);  // held
  EXPECT_EQ(inertial.states.count(1), 0u);  // gone
  EXPECT_EQ(inertial.states.count(2), 1u);
}

TEST(BundleJob, OutliersLeaveTheirLandmarkUnlessTheMapHasLetGoOfThem) {
  Map map = row(2);
  map.keyframe(0).observations[2].depth = 5;
  BundleJob job = extractBundle(map, synthetic::camera(), {1}, {0}, {});
  job.result.usable = true;
  job.result.outliers = {1, 3, 5};  // keyframe 1 of all three
  map.disconnect(1, 0);
  applyBundle(job, map);
  EXPECT_TRUE(map.hasLandmark(0));   // let go of before
  EXPECT_FALSE(map.hasLandmark(1));  // one view is left, without depth
  EXPECT_TRUE(map.hasLandmark(2));   // depth tells where it is
  EXPECT_EQ(map.keyframe(1).observations[2].landmark, kNoLandmark);
  job.result.usable = false;
  job.problem.points[0] = {9, 9, 9};
  applyBundle(job, map);
  EXPECT_EQ(map.landmark(0).position, Eigen::Vector3d(0, 0, 5));
}

}  // namespace
}  // namespace visual_frontend
