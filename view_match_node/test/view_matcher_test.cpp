// A textured corner seen by both robots: the MAV's map, of unknown unit and turned, is found in the ground robot's.
#include <gtest/gtest.h>

#include <utility>

#include "textured_corner.h"

namespace view_match {
namespace {

class ViewMatching : public testing::Test, protected CornerScene {
 protected:
  void addGroundViews(const Corner& corner, ViewMatcher& matcher) const {
    for (const KeyframeView& view : groundViews(corner)) matcher.addKeyframe(view);
  }

  /// The corner's views `shift` along x [m], where it looks the same.
  void addTwin(const Corner& corner, ViewMatcher& matcher, double shift, std::uint32_t first_id) const {
    for (KeyframeView view : groundViews(corner)) {
      view.T_ground_camera = Eigen::Translation3d(shift, 0, 0) * view.T_ground_camera;
      view.id += first_id;
      matcher.addKeyframe(view);
    }
  }

  /// As the node adds them.
  void placeGroundViews(const Corner& corner, ViewMatcher& matcher) const {
    addGroundViews(corner, matcher);
    std::map<std::uint32_t, Pose> poses;
    for (const KeyframeView& view : groundViews(corner)) poses[view.id] = view.T_ground_camera;
    matcher.setPoses(poses);
  }

  bool addView(const Corner& corner, ViewMatcher& matcher, const Pose& T_ground_camera, std::int64_t stamp = 0) const {
    cv::Mat depth;
    const cv::Mat image = render(corner, T_ground_camera, &depth);
    return matcher.addImage(stamp, image, camera, inMavMap(T_ground_camera), landmarks(depth, T_ground_camera));
  }

  static constexpr std::int64_t kStep = 50000000;  // [ns]

  /// A matcher that saw the flight while the MAV's map was another than `truth` says.
  ViewMatcher afterFlightIn(const Similarity& map, const Corner& corner) {
    ViewMatcher matcher({});
    matcher.setOwnUnit(true);
    addGroundViews(corner, matcher);
    const Similarity right = std::exchange(truth, map);
    for (int i = 0; i < 7; ++i) addView(corner, matcher, flown(i), i * kStep);
    truth = right;
    return matcher;
  }

  air_ground_common::PosesByStamp flightAsItIs() const {
    air_ground_common::PosesByStamp now;
    for (int i = 0; i < 7; ++i) now[i * kStep + 200] = inMavMap(flown(i));  // stamps that were seconds
    return now;
  }

  void addFlight(const Corner& corner, ViewMatcher& matcher) const {
    for (int i = 0; i < 7; ++i) addView(corner, matcher, flown(i));
  }
};

TEST_F(ViewMatching, FindsPlaceAttitudeAndScaleOfAMapWithoutUnit) {
  const Corner corner(1);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  EXPECT_NE(matcher.estimate().reason.find("keyframes"), std::string::npos);
  addGroundViews(corner, matcher);
  EXPECT_NE(matcher.estimate().reason.find("images"), std::string::npos);
  addFlight(corner, matcher);
  const MatchEstimate e = matcher.estimate();
  ASSERT_EQ(e.status, MatchStatus::kConverged) << e.reason;
  EXPECT_GE(e.images, 5) << e.reason;
  EXPECT_NEAR(e.T_ground_mav.scale / truth.scale, 1, 0.02);
  EXPECT_LT(air_ground_common::rotationAngle(e.T_ground_mav.R, truth.R), 0.01);
  for (int i = 0; i < 7; ++i)
    EXPECT_LT((e.T_ground_mav * inMavMap(flown(i)).translation() - flown(i).translation()).norm(), 0.04);
}

// Cameras 5 cm apart tell no scale; what they see does.
TEST_F(ViewMatching, DepthsTellTheScaleBeforeTheMavHasMovedFar) {
  const Corner corner(5);
  MatcherSettings settings;
  settings.new_view = settings.min_baseline = 0.01;
  ViewMatcher matcher(settings);
  matcher.setOwnUnit(true);
  addGroundViews(corner, matcher);
  for (int i = 0; i < 5; ++i) addView(corner, matcher, lookingAt({-0.2 + 0.05 * i, 0.3, 1.0}, {0.5, 4, 0.7}));
  const MatchEstimate e = matcher.estimate();
  ASSERT_EQ(e.status, MatchStatus::kConverged) << e.reason;
  EXPECT_NEAR(e.T_ground_mav.scale / truth.scale, 1, 0.02);
}

// Images of a map that is 10 cm and some degrees off at first.
TEST_F(ViewMatching, ImagesFollowACorrectionOfTheMavsMap) {
  Similarity off = truth;
  off.R = truth.R * air_ground_common::expSO3({0.05, 0.02, -0.04});
  off.t += Eigen::Vector3d(0.06, -0.06, 0.05);
  ViewMatcher matcher = afterFlightIn(off, Corner(1));
  const auto error = [&](const MatchEstimate& e) {
    return (e.T_ground_mav * inMavMap(flown(3)).translation() - flown(3).translation()).norm();
  };
  EXPECT_GT(error(matcher.estimate()), 0.05);
  matcher.correctAerial(flightAsItIs());
  const MatchEstimate e = matcher.estimate();
  ASSERT_EQ(e.status, MatchStatus::kConverged) << e.reason;
  EXPECT_LT(error(e), 0.04);
}

// The MAV's map was 6 % too small: so are the depths of what its images showed then.
TEST_F(ViewMatching, ScalesFollowACorrectionOfTheMavsMap) {
  Similarity large = truth;
  large.scale *= 1.06;
  ViewMatcher matcher = afterFlightIn(large, Corner(1));
  matcher.correctAerial(flightAsItIs());
  const MatchEstimate e = matcher.estimate();
  ASSERT_EQ(e.status, MatchStatus::kConverged) << e.reason;
  EXPECT_NEAR(e.T_ground_mav.scale / truth.scale, 1, 0.01);
}

TEST_F(ViewMatching, AMetricMapKeepsItsScale) {
  truth.scale = 1;
  const Corner corner(2);
  ViewMatcher matcher({});
  addGroundViews(corner, matcher);
  addFlight(corner, matcher);
  const MatchEstimate e = matcher.estimate();
  ASSERT_EQ(e.status, MatchStatus::kConverged) << e.reason;
  EXPECT_NEAR(e.T_ground_mav.scale, 1, 0.02);
}

// What looks down is not compared with what looks ahead, and the reason says so; without gravity nobody knows.
TEST_F(ViewMatching, ImagesOfOtherElevationsAreNotCompared) {
  truth.scale = 1;
  truth.R = Eigen::AngleAxisd(1.3, Eigen::Vector3d::UnitX()).toRotationMatrix() * truth.R;
  const Corner corner(2);
  for (const bool own_unit : {false, true}) {
    ViewMatcher matcher({});
    matcher.setOwnUnit(own_unit);
    addGroundViews(corner, matcher);
    addFlight(corner, matcher);
    const MatchEstimate e = matcher.estimate();
    EXPECT_EQ(e.status, own_unit ? MatchStatus::kConverged : MatchStatus::kSearching) << e.reason;
    if (!own_unit) {
      EXPECT_NE(e.reason.find("degrees higher or lower"), std::string::npos) << e.reason;
    }
  }
}

TEST_F(ViewMatching, FollowsTheGroundMapWhenItMoves) {
  truth.scale = 1;
  const Corner corner(3);
  ViewMatcher matcher({});
  addGroundViews(corner, matcher);
  addFlight(corner, matcher);
  ASSERT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
  // A loop closure carries all keyframes a metre along x.
  std::map<std::uint32_t, Pose> poses;
  for (const KeyframeView& view : groundViews(corner))
    poses[view.id] = Eigen::Translation3d(1, 0, 0) * view.T_ground_camera;
  const Eigen::Vector3d before = matcher.estimate().T_ground_mav.t;
  matcher.setPoses(poses);
  EXPECT_NEAR((matcher.estimate().T_ground_mav.t - before - Eigen::Vector3d(1, 0, 0)).norm(), 0, 1e-6);
  matcher.setPoses({});
  EXPECT_EQ(matcher.keyframes(), 0u);
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kSearching);
}

TEST_F(ViewMatching, ImagesWaitForTheGroundRobotToSeeTheSame) {
  const Corner corner(4);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addFlight(corner, matcher);
  EXPECT_FALSE(matcher.matchWaiting());
  addGroundViews(corner, matcher);
  EXPECT_TRUE(matcher.matchWaiting());
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
}

// It saw the corner, then for long something else: what it saw first is what the ground robot comes to.
TEST_F(ViewMatching, AHoveringMavKeepsWhatItSawBefore) {
  const Corner corner(4), elsewhere(99);
  MatcherSettings settings;
  settings.max_waiting = 8;
  ViewMatcher matcher(settings);
  matcher.setOwnUnit(true);
  addFlight(corner, matcher);
  cv::Mat depth;
  const cv::Mat image = render(elsewhere, flown(3), &depth);
  for (int i = 0; i < 20; ++i) {
    const Pose T = Eigen::Translation3d(0.01 * (i % 3), 0, 0) * flown(3);
    matcher.addImage(100 + i, image, camera, inMavMap(T), landmarks(depth, T));
  }
  addGroundViews(corner, matcher);
  EXPECT_TRUE(matcher.matchWaiting());
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
}

// More views than may wait: of neighbours one goes, and the first stays.
TEST_F(ViewMatching, ViewsThatDifferLeastGoWhereTooManyWait) {
  const Corner corner(4);
  MatcherSettings settings;
  settings.max_waiting = 7;
  settings.new_view = 0.01;
  ViewMatcher matcher(settings);
  matcher.setOwnUnit(true);
  addFlight(corner, matcher);
  // On past the corner, in steps smaller than those of the flight.
  for (int i = 0; i < 12; ++i) {
    const double x = 0.75 + 0.06 * i;
    addView(Corner(99), matcher, lookingAt({x, 0.6, 1.4}, {x + 0.2, 4, 0.7}), 100 + i);
  }
  addGroundViews(corner, matcher);
  EXPECT_TRUE(matcher.matchWaiting());
  EXPECT_GE(matcher.cameras().size(), 4u);
}

// The ground robot was lost and maps the same place anew: the MAV need not come again.
TEST_F(ViewMatching, ImagesAreLookedForInTheNextGroundMap) {
  const Corner corner(4);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addGroundViews(corner, matcher);
  addFlight(corner, matcher);
  const MatchEstimate before = matcher.estimate();
  ASSERT_EQ(before.status, MatchStatus::kConverged) << before.reason;
  matcher.forgetGround();
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kSearching);
  addGroundViews(corner, matcher);
  EXPECT_TRUE(matcher.matchWaiting());
  const MatchEstimate after = matcher.estimate();
  EXPECT_EQ(after.status, MatchStatus::kConverged) << after.reason;
  EXPECT_LT((after.T_ground_mav.t - before.T_ground_mav.t).norm(), 0.02);
}

// A keyframe is taken out of the map, and nothing of its view stays: one of that view comes later.
TEST_F(ViewMatching, ImagesOfAKeyframeThatIsGoneWaitForAnother) {
  const Corner corner(3);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addGroundViews(corner, matcher);
  addFlight(corner, matcher);
  ASSERT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
  matcher.setPoses({});
  ASSERT_EQ(matcher.estimate().images, 0);
  addGroundViews(corner, matcher);
  EXPECT_TRUE(matcher.matchWaiting());
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
}

// Two places that look alike, and a keyframe more of the wrong one: it alone has no rival.
TEST_F(ViewMatching, AnImageOfTwoPlacesIsNotTakenAtTheNextKeyframeOfOne) {
  const Corner corner(4);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addTwin(corner, matcher, 0, 0);
  addTwin(corner, matcher, 6, 1000);
  addFlight(corner, matcher);
  ASSERT_EQ(matcher.estimate().status, MatchStatus::kSearching);
  addTwin(corner, matcher, 6.01, 2000);
  EXPECT_FALSE(matcher.matchWaiting());
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kSearching) << matcher.estimate().reason;
}

// The ground robot comes to the other one of two equal desks after the MAV: who was told of the first is told now.
TEST_F(ViewMatching, ImagesAreTakenBackWhenATwinOfTheirPlaceIsMapped) {
  const Corner corner(4);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addTwin(corner, matcher, 0, 0);
  addFlight(corner, matcher);
  ASSERT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
  addTwin(corner, matcher, 6, 1000);
  EXPECT_FALSE(matcher.matchWaiting());
  const MatchEstimate e = matcher.estimate();
  EXPECT_EQ(e.status, MatchStatus::kAmbiguous) << e.reason;
  EXPECT_NE(e.reason.find("two places look alike"), std::string::npos) << e.reason;
  matcher.forgetGround();
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kSearching);
  addTwin(corner, matcher, 0, 2000);
  EXPECT_TRUE(matcher.matchWaiting());
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
}

// The ground robot drives on: to another place, and along the one that the images show.
TEST_F(ViewMatching, KeyframesThatAreNoTwinTakeNothingBack) {
  const Corner corner(4);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addTwin(corner, matcher, 0, 0);
  addFlight(corner, matcher);
  const MatchEstimate before = matcher.estimate();
  ASSERT_EQ(before.status, MatchStatus::kConverged) << before.reason;
  addTwin(Corner(99), matcher, 6, 1000);
  addTwin(corner, matcher, 0.01, 2000);
  EXPECT_FALSE(matcher.matchWaiting());
  const MatchEstimate after = matcher.estimate();
  EXPECT_EQ(after.status, MatchStatus::kConverged) << after.reason;
  EXPECT_EQ(after.images, before.images);
  EXPECT_LT((after.T_ground_mav.t - before.T_ground_mav.t).norm(), 1e-9);
}

// Once as they stand, once while the loop that they close moves all of the map.
TEST_F(ViewMatching, ImagesFollowAKeyframeThatIsReplaced) {
  truth.scale = 1;
  const Corner corner(3);
  for (const double shift : {0.0, 0.3}) {
    const Pose T_now_then(Eigen::Translation3d(shift, -0.5 * shift, 0));
    ViewMatcher matcher({});
    placeGroundViews(corner, matcher);
    addFlight(corner, matcher);
    const MatchEstimate before = matcher.estimate();
    ASSERT_EQ(before.status, MatchStatus::kConverged) << before.reason;
    std::map<std::uint32_t, Pose> poses;
    for (KeyframeView view : groundViews(corner)) {
      if (!poses.empty()) {  // one stays
        view.id += 500;
        view.T_ground_camera = view.T_ground_camera * Pose(Eigen::Translation3d(0.02, 0.01, 0)) *
                               Pose(Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()));
      }
      poses[view.id] = view.T_ground_camera = T_now_then * view.T_ground_camera;
      matcher.addKeyframe(view);
    }
    matcher.setPoses(poses);
    const MatchEstimate after = matcher.estimate();
    EXPECT_EQ(after.status, MatchStatus::kConverged) << after.reason;
    EXPECT_EQ(after.images, before.images);
    EXPECT_LT((after.T_ground_mav.t - T_now_then * before.T_ground_mav.t).norm(), 1e-3) << shift;
    const auto variance = [](const MatchEstimate& e) { return e.covariance.diagonal().head<3>().sum(); };
    EXPECT_NEAR(variance(after) / variance(before), 1, 0.02);
  }
}

// All of them are replaced at once: nobody knows how the map has moved.
TEST_F(ViewMatching, ImagesOfKeyframesOfWhichNoneStaysWait) {
  truth.scale = 1;
  const Corner corner(3);
  ViewMatcher matcher({});
  placeGroundViews(corner, matcher);
  addFlight(corner, matcher);
  std::map<std::uint32_t, Pose> poses;
  for (KeyframeView view : groundViews(corner)) {
    view.id += 500;
    poses[view.id] = view.T_ground_camera = Pose(Eigen::Translation3d(0.3, 0, 0)) * view.T_ground_camera;
    matcher.addKeyframe(view);
  }
  const MatchEstimate before = matcher.estimate();
  matcher.setPoses(poses);
  EXPECT_EQ(matcher.estimate().images, 0);
  EXPECT_TRUE(matcher.matchWaiting());
  const MatchEstimate after = matcher.estimate();
  ASSERT_EQ(after.status, MatchStatus::kConverged) << after.reason;
  EXPECT_LT((after.T_ground_mav.t - before.T_ground_mav.t - Eigen::Vector3d(0.3, 0, 0)).norm(), 0.02);
}

// A corner that drift has mapped twice is one when the loop closes: what was seen of it is looked for again.
TEST_F(ViewMatching, ImagesOfAPlaceMappedTwiceAreFoundOnceTheLoopCloses) {
  truth.scale = 1;
  const Corner corner(4);
  ViewMatcher matcher({});
  std::map<std::uint32_t, Pose> drifted, closed;
  for (const std::uint32_t round : {0, 1000})
    for (KeyframeView view : groundViews(corner)) {
      view.id += round;
      closed[view.id] = view.T_ground_camera;
      if (round > 0) view.T_ground_camera = Pose(Eigen::Translation3d(1.2, 0, 0)) * view.T_ground_camera;
      drifted[view.id] = view.T_ground_camera;
      matcher.addKeyframe(view);
    }
  matcher.setPoses(drifted);
  addFlight(corner, matcher);
  ASSERT_NE(matcher.estimate().status, MatchStatus::kConverged);
  EXPECT_FALSE(matcher.matchWaiting());
  matcher.setPoses(closed);
  EXPECT_TRUE(matcher.matchWaiting());
  const MatchEstimate e = matcher.estimate();
  ASSERT_EQ(e.status, MatchStatus::kConverged) << e.reason;
  EXPECT_LT((e.T_ground_mav * inMavMap(flown(3)).translation() - flown(3).translation()).norm(), 0.04);
}

// The same where the MAV was there between both visits: what drift took back comes back.
TEST_F(ViewMatching, ImagesTakenBackForDriftAreFoundOnceTheLoopCloses) {
  truth.scale = 1;
  const Corner corner(4);
  ViewMatcher matcher({});
  placeGroundViews(corner, matcher);
  addFlight(corner, matcher);
  ASSERT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
  std::map<std::uint32_t, Pose> drifted, closed;
  for (const KeyframeView& view : groundViews(corner)) {
    drifted[view.id] = closed[view.id] = closed[view.id + 1000] = view.T_ground_camera;
    drifted[view.id + 1000] = Pose(Eigen::Translation3d(2.5, 0, 0)) * view.T_ground_camera;
  }
  addTwin(corner, matcher, 2.5, 1000);
  matcher.setPoses(drifted);
  matcher.matchWaiting();
  ASSERT_EQ(matcher.estimate().status, MatchStatus::kAmbiguous) << matcher.estimate().reason;
  matcher.setPoses(closed);
  EXPECT_TRUE(matcher.matchWaiting());
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kConverged) << matcher.estimate().reason;
}

TEST_F(ViewMatching, KeyframesThatComeAgainChangeNothing) {
  const Corner corner(1);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addGroundViews(corner, matcher);
  addFlight(corner, matcher);
  const Eigen::Vector3d before = matcher.estimate().T_ground_mav.t;
  addGroundViews(corner, matcher);
  EXPECT_EQ(matcher.keyframes(), 5u);
  EXPECT_LT((matcher.estimate().T_ground_mav.t - before).norm(), 1e-9);
}

TEST_F(ViewMatching, AnotherPlaceIsNotRecognised) {
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addGroundViews(Corner(1), matcher);
  addFlight(Corner(99), matcher);
  EXPECT_EQ(matcher.estimate().status, MatchStatus::kSearching);
  EXPECT_EQ(matcher.estimate().images, 0);
}

TEST_F(ViewMatching, ImagesFromOnePlaceAreOneView) {
  const Corner corner(1);
  ViewMatcher matcher({});
  matcher.setOwnUnit(true);
  addGroundViews(corner, matcher);
  EXPECT_TRUE(addView(corner, matcher, flown(0)));
  EXPECT_FALSE(addView(corner, matcher, flown(0)));
}

TEST_F(ViewMatching, RefusesFeaturesThatDoNotFit) {
  ViewMatcher matcher({});
  KeyframeView view;
  view.points = {{0, 0, 1}, {0, 0, 2}};
  view.descriptors = cv::Mat::zeros(1, 32, CV_8UC1);
  EXPECT_THROW(matcher.addKeyframe(view), std::invalid_argument);
  view.descriptors = cv::Mat::zeros(2, 32, CV_8UC1);
  view.points[1].z() = -2;
  EXPECT_THROW(matcher.addKeyframe(view), std::invalid_argument);
}

}  // namespace
}  // namespace view_match
