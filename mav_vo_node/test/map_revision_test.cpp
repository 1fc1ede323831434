#include "../src/map_revision.h"

#include <gtest/gtest.h>

namespace mav_vo {
namespace {

struct Flight {
  visual_frontend::Map map;
  MapRevision revision;

  void add(double x) {
    visual_frontend::Keyframe keyframe;
    keyframe.T_map_camera.translation().x() = x;
    map.addKeyframe(keyframe);
    revision.follow(map, 3);
  }
  void scale(double factor) {
    map.transform({factor, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()});
    revision.follow(map, 3);
  }
};

TEST(MapRevision, CountsCorrectionsOfTwoThousandthsOfTheScenesDistanceInSum) {
  Flight flight;
  for (int i = 0; i < 10; ++i) flight.add(4 + 0.1 * i);
  EXPECT_EQ(flight.revision.corrections(), 0u);
  flight.scale(1.001);  // 4.4 mm of 3 m
  EXPECT_EQ(flight.revision.corrections(), 0u);
  flight.scale(1.001);
  EXPECT_EQ(flight.revision.corrections(), 1u) << "small steps add up";
  flight.scale(1.001);
  EXPECT_EQ(flight.revision.corrections(), 1u) << "of the map as it was corrected last";
}

TEST(MapRevision, NeitherAnotherUnitNorKeyframesThatCome) {
  Flight flight;
  for (int i = 0; i < 100; ++i) flight.add(0.1 * i);
  flight.revision.restart();
  flight.scale(2);
  EXPECT_EQ(flight.revision.corrections(), 0u);
  for (int i = 0; i < 100; ++i) flight.add(20);
  EXPECT_EQ(flight.revision.corrections(), 0u);
}

TEST(MapRevision, BentRaysAreAnotherMatter) {
  Flight flight;
  for (int i = 0; i < 10; ++i) flight.add(4 + 0.1 * i);
  flight.scale(1.05);
  EXPECT_EQ(flight.revision.count(), 0u);
  flight.revision.next();
  EXPECT_EQ(flight.revision.count(), 1u);
  EXPECT_EQ(flight.revision.corrections(), 1u);
}

}  // namespace
}  // namespace mav_vo
