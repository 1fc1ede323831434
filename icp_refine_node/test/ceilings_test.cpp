// A ground map of a room: what the ground robot saw from below is no top of what lies under it.
#include <random>

#include "icp_refine/ceilings.h"
#include "refiner_fixture.h"

namespace icp_refine {
namespace {

/// The scene in a room of 2.5 m, which the ground robot's camera, 0.5 m above the floor, saw the ceiling of.
class Room : public Refiner {
 protected:
  Room() {
    std::mt19937 random(4);
    std::normal_distribution<double> noise(0, 0.008);
    const Pose T_map_world = scene.T_world_ground_map.inverse();
    for (double x = -4; x < 4; x += 0.03)
      for (double y = -4; y < 4; y += 0.03)
        scene.ground.points.push_back((T_map_world * Eigen::Vector3d(x, y, 2.5 + noise(random))).cast<float>());
    refiner.setGround(scene.ground);
    camera = (T_map_world * Eigen::Vector3d(0, 0, 0.5)).z();
  }
  double camera;
};

TEST_F(Room, IsAlignedBelowItsCeiling) {
  refiner.setGroundCamera(camera);
  refiner.setCoarse(moved(0.15, -0.1, 0.05, 0.05));
  const auto out = refiner.refine();
  ASSERT_EQ(out.status, RefineStatus::kConverged) << out.reason;
  EXPECT_LT(error(out.T_ground_map_mav_map), 0.08);
}

TEST_F(Room, AWrongPoseIsContradictedBelowTheCeilingToo) {
  refiner.setGroundCamera(camera);
  refiner.setCoarse(moved(0.4, 0.3, 0, 2.4));
  EXPECT_NE(refiner.refine().status, RefineStatus::kConverged);
}

TEST_F(Room, TheCamerasHeightMayComeAfterTheMap) {
  refiner.setCoarse(moved(0.1, 0.1, 0, 0.05));
  EXPECT_NE(refiner.refine().status, RefineStatus::kConverged);
  refiner.setGroundCamera(camera);
  refiner.setCoarse(moved(0.1, 0.1, 0, 0.05));
  const auto out = refiner.refine();
  EXPECT_EQ(out.status, RefineStatus::kConverged) << out.reason;
}

// Terrain is seen from below, too: a hillside above the camera, the top of a step that it stands before. A table stays:
// its top is where its underside is.
// A table of 3 cm over a floor, whose edge and underside the ground robot saw, and a wall behind.
TEST(OnUndersides, AreWhereSomethingHidesWhatIsAboveTheFloor) {
  const float nothing = std::numeric_limits<float>::quiet_NaN();
  std::vector<Eigen::Vector3f> points;
  std::vector<float> hidden_from;
  const auto add = [&](float x, float z, float from) {
    points.emplace_back(x, 0.02f, z);
    hidden_from.push_back(from);
  };
  add(0.02f, 0.01f, 0.7f);
  add(0.02f, 0.71f, nothing);  // underside
  add(0.07f, 0.72f, nothing);  // where the floor was not seen
  add(0.02f, 0.3f, nothing);   // a leg
  add(0.02f, 0.95f, nothing);  // something on the table
  add(0.3f, 0.71f, nothing);   // a shelf elsewhere
  add(0.3f, 0.0f, nothing);
  EXPECT_EQ(onUndersides(points, hidden_from), (std::vector<char>{0, 1, 1, 0, 0, 0, 0}));
  EXPECT_THROW(onUndersides(points, {nothing}), std::invalid_argument);
}

TEST(OnCeilings, WhatHasNothingFarBeneathItIsNone) {
  Cloud cloud;
  std::vector<char> expected;
  const auto add = [&](float x, float y, float z, const Eigen::Vector3f& normal, bool ceiling) {
    cloud.points.emplace_back(x, y, z);
    cloud.normals.push_back(normal.normalized());
    expected.push_back(ceiling);
  };
  // The floor below is not all seen.
  for (float x = 1.02f; x < 3; x += 0.05f)
    for (float y = -3; y < 0; y += 0.05f) add(x, y, 2.4f, {0, 0.1f, 1}, true);
  for (float x = 0.02f; x < 12; x += 0.05f)
    for (float y = 0.02f; y < 2; y += 0.05f) {
      const float slope = 0.3f, above = std::max(0.f, x - 4);
      add(x, y, slope * above, {x > 4 ? -slope : 0, 0, 1}, false);
      if (x < 1) add(x, y, 0.75f, {0, 0, 1}, false);
      if (x > 1 && x < 3) add(x, y, 2.4f, {0.1f, 0, 1}, true);
      if (x > 1 && x < 3) add(x, 2, 1.2f * y, {0, 1, 0}, false);  // a wall up to it
    }
  EXPECT_EQ(onCeilings(cloud, 0.5), expected);
  EXPECT_EQ(onCeilings(cloud, std::numeric_limits<double>::infinity()), std::vector<char>(cloud.size(), 0));
}

}  // namespace
}  // namespace icp_refine
