// What the height check may hold against a pose, on clouds made by hand.
#include "icp_refine/height_check.h"

#include <gtest/gtest.h>

namespace icp_refine {
namespace {

// Points every 2 cm at one height.
void addLevel(Cloud& cloud, double x0, double x1, double y0, double y1, double z) {
  for (double x = x0 + 0.01; x < x1; x += 0.02) {
    for (double y = y0 + 0.01; y < y1; y += 0.02) cloud.points.push_back(Eigen::Vector3d(x, y, z).cast<float>());
  }
}

// The ground robot looked under a table, and saw nothing of its top. Columns of 0.1 m: 10 by 6 of the table.
TEST(HeightCheck, ATableAboveTheGroundCameraSaysNothing) {
  HeightCheckSettings s;
  s.cell = 0.1;
  Cloud ground, aerial;
  addLevel(ground, 0, 3, 0, 3, 0);
  addLevel(aerial, 0, 3, 0, 3, 0);
  addLevel(aerial, 1, 2, 1, 1.6, 0.72);
  EXPECT_EQ(checkHeights(aerial, ground, s, 0.5).relief_cells, 0);
  // Who looks from above sees the top where there is one.
  for (const double camera : {1.5, std::numeric_limits<double>::infinity()}) {
    const auto seen = checkHeights(aerial, ground, s, camera);
    EXPECT_EQ(seen.relief_cells, 60);
    EXPECT_EQ(seen.contradictions, 60);
  }
}

// Half a metre of wall in the ground map, at the edge of what the image showed or amid it.
TEST(HeightCheck, AWallThatTheImageCutSaysNothing) {
  HeightCheckSettings s;
  s.cell = 0.1;
  Cloud ground, aerial;
  addLevel(ground, 0, 3, 0, 3, 0);
  addLevel(ground, 1.9, 2, 1, 2, 0.5);
  addLevel(aerial, 0, 2, 0, 3, 0);
  EXPECT_EQ(checkHeights(aerial, ground, s).relief_cells, 0);
  addLevel(aerial, 2, 3, 0, 3, 0);
  EXPECT_EQ(checkHeights(aerial, ground, s).contradictions, 10);
}

}  // namespace
}  // namespace icp_refine
