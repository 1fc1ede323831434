#include "../src/posed_image_selection.h"

#include <gtest/gtest.h>

#include "air_ground_common/geometry.h"

namespace mav_vo {
namespace {

struct Flight {
  PosedImageSelection selection{0.02};
  VoResult frame;

  Flight() {
    frame.metric = true;
    frame.map_id = 1;
    selection.selects(frame);
  }
  /// An image 50 ms later, at x.
  bool at(double x) {
    frame.stamp += 0.05;
    frame.T_map_camera.translation().x() = x;
    return selection.selects(frame);
  }
};

TEST(PosedImageSelection, FirstImageThenThoseFromElsewhere) {
  PosedImageSelection selection(0.02);
  EXPECT_TRUE(selection.selects(VoResult()));
  Flight flight;
  EXPECT_FALSE(flight.at(0.01));
  EXPECT_TRUE(flight.at(0.03)) << "measured from the last one selected";
  EXPECT_FALSE(flight.at(0.015));
}

TEST(PosedImageSelection, HoveringAtLeastFiveASecond) {
  Flight flight;
  int selected = 0;
  for (int i = 0; i < 40; ++i) selected += flight.at(0);
  EXPECT_EQ(selected, 10);
}

TEST(PosedImageSelection, TurnsKeyframesAndOtherMaps) {
  Flight flight;
  flight.frame.T_map_camera.linear() = air_ground_common::expSO3({0, 0, 0.06});
  EXPECT_TRUE(flight.at(0));
  EXPECT_FALSE(flight.at(0));
  flight.frame.keyframe = true;
  EXPECT_TRUE(flight.at(0));
  flight.frame.keyframe = false;
  flight.frame.map_revision = 1;
  EXPECT_TRUE(flight.at(0));
  flight.frame.map_id = 2;
  EXPECT_TRUE(flight.at(0));
  flight.frame.stamp -= 10;
  EXPECT_TRUE(flight.at(0)) << "a clock that ran back";
}

TEST(PosedImageSelection, WithoutScaleAsIfTheSceneWereTwoMetresAway) {
  Flight flight;
  flight.frame.metric = false;
  flight.frame.depth_min = 0.5;
  flight.frame.depth_max = 2;  // one unit away: 2 cm of 2 m are 0.01
  EXPECT_FALSE(flight.at(0.009));
  EXPECT_TRUE(flight.at(0.011));
}

TEST(PosedImageSelection, KnowsWhichOfTheMapItHasSelected) {
  Flight flight;
  for (const double x : {0.01, 0.03, 0.04, 0.06}) flight.at(x);
  air_ground_common::Trajectory trajectory(5);
  for (std::size_t i = 1; i < trajectory.size(); ++i) trajectory[i].stamp = trajectory[i - 1].stamp + 0.05;
  const auto selected = flight.selection.selected(trajectory);
  ASSERT_EQ(selected.size(), 3u);
  EXPECT_EQ(selected[1].stamp, trajectory[2].stamp);
  EXPECT_EQ(selected[2].stamp, trajectory[4].stamp);
  flight.frame.map_id = 2;
  flight.at(0);
  EXPECT_TRUE(flight.selection.selected(trajectory).empty()) << "of another map";
}

TEST(PosedImageSelection, AllWithoutSpacing) {
  PosedImageSelection selection(0);
  VoResult frame;
  for (int i = 0; i < 5; ++i) {
    frame.stamp += 0.01;
    EXPECT_TRUE(selection.selects(frame));
  }
}

}  // namespace
}  // namespace mav_vo
