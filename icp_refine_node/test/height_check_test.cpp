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
  EXPECT_EQ(GroundHeights(ground, s).check(aerial, 0.5).relief_cells, 0);
  // Who looks from above sees the top where there is one.
  for (const double camera : {1.5, std::numeric_limits<double>::infinity()}) {
    const auto seen = GroundHeights(ground, s).check(aerial, camera);
    EXPECT_EQ(seen.relief_cells, 60);
    EXPECT_EQ(seen.contradictions, 60);
  }
}

// Five boxes on a slope, and the aerial cloud half a metre off along a contour: bare slope agrees wherever it is put.
TEST(HeightCheck, ASlopeProvesNoPlaceAlongItsContours) {
  for (const double slope : {0.0, 0.07, -0.2}) {
    const auto scene = [slope](double shift) {
      Cloud cloud;
      addLevel(cloud, -1, 7, -1, 7, 0);
      for (const auto& [x, y] : {std::pair(1.0, 1.2), {4.3, 0.9}, {2.6, 2.9}, {0.8, 4.6}, {4.9, 4.4}})
        addLevel(cloud, x + shift, x + shift + 0.5, y, y + 0.5, 0.4);
      for (auto& p : cloud.points) p.z() += static_cast<float>(slope * p.y());
      return cloud;
    };
    const HeightCheck right = GroundHeights(scene(0)).check(scene(0)),
                      wrong = GroundHeights(scene(0)).check(scene(0.6));
    EXPECT_TRUE(right.conclusive) << slope;
    EXPECT_GT(right.agreement(), 0.98) << slope;
    EXPECT_LT(wrong.agreement(), 0.5) << slope << ": of " << wrong.relief_cells;
    EXPECT_LT(right.relief_cells, 600) << slope << ": the boxes alone";
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
  EXPECT_EQ(GroundHeights(ground, s).check(aerial).relief_cells, 0);
  addLevel(aerial, 2, 3, 0, 3, 0);
  EXPECT_EQ(GroundHeights(ground, s).check(aerial).contradictions, 10);
}

}  // namespace
}  // namespace icp_refine
