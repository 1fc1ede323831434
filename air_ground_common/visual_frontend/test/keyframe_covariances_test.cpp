#include "visual_frontend/keyframe_covariances.h"

#include <gtest/gtest.h>

#include "synthetic_map.h"

namespace visual_frontend {
namespace {

Matrix6d diagonal(double position, double rotation) {
  Vector6d d;
  d << position, position, position, rotation, rotation, rotation;
  return d.asDiagonal();
}

/// Keyframes at x = 0, 10, 20, ..., each sharing `shared` landmarks with the one before.
Map chain(int keyframes, int shared) {
  Map map;
  std::vector<LandmarkId> before;
  for (int k = 0; k < keyframes; ++k) {
    std::vector<LandmarkId> here, seen = before;
    for (int i = 0; i < shared; ++i) here.push_back(map.addLandmark(Eigen::Vector3d::Zero()));
    seen.insert(seen.end(), here.begin(), here.end());
    Keyframe keyframe = synthetic::keyframeSeeing(seen);
    keyframe.T_map_camera.translation().x() = 10 * k;
    before = here;
    map.addKeyframe(keyframe);
  }
  return map;
}

TEST(KeyframeCovariances, AddUpAlongTheChainOfViews) {
  const Map map = chain(3, 20);
  KeyframeCovariances covariances;
  covariances.add(0, Matrix6d::Zero(), map);
  covariances.add(1, diagonal(1e-4, 1e-6), map);
  covariances.add(2, diagonal(1e-4, 1e-6), map);
  const Matrix6d C = covariances.at(2, {20, 0, 0}, map);
  EXPECT_NEAR(C(0, 0), 18e-4, 1e-12);               // 9 of each
  EXPECT_NEAR(C(1, 1), 18e-4 + 9e-6 * 100, 1e-12);  // keyframe 1 turns this one, 10 m away, sideways
  EXPECT_NEAR(C(5, 5), 18e-6, 1e-15);
  // Fixed to keyframe 1, 2 m above it: x moves by its pitch.
  EXPECT_NEAR(covariances.at(1, {10, 0, 2}, map)(0, 0), 9e-4 + 9e-6 * 4, 1e-12);
}

TEST(KeyframeCovariances, WithoutSharedViewsTheNewestKeyframeCounts) {
  const Map map = chain(2, 19);
  KeyframeCovariances covariances;
  covariances.add(0, diagonal(1, 1), map);
  covariances.add(1, Matrix6d::Zero(), map);
  const Matrix6d C = covariances.at(1, {10, 0, 0}, map);
  EXPECT_NEAR(C(0, 0), 9, 1e-12);
  EXPECT_NEAR(C(1, 1), 9 + 9 * 100, 1e-9);  // keyframe 0 turns this one, 10 m away, sideways
  EXPECT_NEAR(C(5, 5), 9, 1e-12);
  covariances.forget(1);
  EXPECT_EQ(covariances.at(1, {10, 0, 0}, map), Matrix6d::Zero());
}

TEST(KeyframeCovariances, MoveWithTheMap) {
  Map map = chain(1, 1);
  KeyframeCovariances covariances;
  Vector6d d;
  d << 1, 2, 3, 4, 5, 6;
  covariances.add(0, d.asDiagonal(), map);
  // A quarter turn about z, twice the size: x becomes y.
  const air_ground_common::Similarity S{2, air_ground_common::expSO3({0, 0, M_PI / 2}), Eigen::Vector3d(1, 1, 1)};
  map.transform(S);
  covariances.transform(S);
  const Matrix6d C = covariances.at(0, map.keyframe(0).T_map_camera.translation(), map);
  d << 8, 4, 12, 5, 4, 6;
  EXPECT_LT((C - Matrix6d(9 * d.asDiagonal())).norm(), 1e-9);
}

}  // namespace
}  // namespace visual_frontend
