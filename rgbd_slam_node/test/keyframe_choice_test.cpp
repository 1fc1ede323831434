// PlaceSearch and ReferenceKeyframe: when a lost camera looks around, and when a frame is one of another view.
#include <gtest/gtest.h>

#include "../src/place_search.h"
#include "../src/reference_keyframe.h"
#include "simulated_robot.h"

namespace rgbd_slam {
namespace {

using visual_frontend::Keyframe;
using visual_frontend::kNoKeyframe;
using visual_frontend::Map;
using visual_frontend::PlaceMatch;

SlamSettings searching(double interval, double restart_after) {
  SlamSettings settings;
  settings.relocalization_interval = interval;
  settings.restart_after = restart_after;
  settings.place.min_inliers = 20;
  return settings;
}

TEST(PlaceSearch, LooksAtIntervalsAndAtOnceAfterANearMiss) {
  PlaceSearch search(searching(0.5, 0));
  EXPECT_TRUE(search.due(100));
  search.begin(100);
  search.conclude({}, "nothing alike");
  EXPECT_EQ(search.reason(), "nothing alike");
  EXPECT_FALSE(search.due(100.4));
  EXPECT_TRUE(search.due(100.5));
  PlaceMatch match;
  match.inliers = 12;
  search.conclude(match, "");
  EXPECT_FALSE(search.due(100.1)) << "60 % of those needed are no near miss yet";
  match.inliers = 13;
  search.conclude(match, "");
  EXPECT_TRUE(search.due(100.1));
  search.clear();
  search.begin(200);
  EXPECT_FALSE(search.due(200.1));
}

TEST(PlaceSearch, GivesUpAfterStrangePlacesOnly) {
  PlaceSearch search(searching(0.5, 2));
  const auto look = [&](double from, int times, bool place) {
    for (int i = 0; i < times; ++i) {
      search.begin(from + 0.5 * i);
      if (place) search.sawAPlace();
    }
  };
  look(100, 20, false);
  EXPECT_FALSE(search.givesUp()) << "dark";
  look(110, 4, true);  // 2 s, of which the first half second passed before a place was seen
  EXPECT_TRUE(search.givesUp());
  search.found();
  EXPECT_FALSE(search.givesUp());
  look(120, 4, true);
  EXPECT_FALSE(search.givesUp()) << "what the gap before hid is not known to be strange";
  look(122, 1, true);
  EXPECT_TRUE(search.givesUp());
  search.clear();
  EXPECT_FALSE(search.givesUp());
}

// Looks that are seconds apart, because the settings or the camera's rate say so, hide no more than others.
TEST(PlaceSearch, GivesUpHoweverSlowlyItLooks) {
  for (const double interval : {0.1, 3.0}) {
    PlaceSearch search(searching(interval, 5));
    double stamp = 100;
    for (int i = 0; i < 4 && !search.givesUp(); ++i, stamp += 3) {
      search.begin(stamp);
      search.sawAPlace();
    }
    EXPECT_TRUE(search.givesUp()) << interval;
    search.found();
    search.begin(stamp += 30);
    search.sawAPlace();
    EXPECT_FALSE(search.givesUp()) << "it was not lost meanwhile";
  }
}

TEST(PlaceSearch, NeverGivesUpWhereItIsToldSo) {
  PlaceSearch search(searching(0.5, 0));
  for (int i = 0; i < 100; ++i) {
    search.begin(0.5 * i);
    search.sawAPlace();
  }
  EXPECT_FALSE(search.givesUp());
}

/// A keyframe at the origin that sees 100 landmarks 2 m away.
struct Reference : ::testing::Test {
  Reference() {
    settings.keyframe_translation = 0.15;
    settings.keyframe_rotation = 0.2;
    settings.keyframe_overlap = 0.55;
    settings.keyframe_min_gap = 3;
    settings.min_inliers = 15;
    for (int i = 0; i < 100; ++i) landmarks.push_back(map.addLandmark({0.01 * i - 0.5, 0, 2}));
    id = add(moved(0));
    reference.set(map, id);
    for (int i = 0; i < 3; ++i) reference.countFrame();
  }
  static Pose moved(double distance, double angle = 0) {
    Pose T(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()));
    T.translation().x() = distance;
    return T;
  }
  KeyframeId add(const Pose& T_map_camera) {
    Keyframe keyframe;
    keyframe.T_map_camera = T_map_camera;
    for (const LandmarkId landmark : landmarks) {
      keyframe.observations.emplace_back();
      keyframe.observations.back().landmark = landmark;
    }
    return map.addKeyframe(keyframe);
  }
  bool due(const Pose& T_map_camera, int seen = 100) const { return reference.due(map, T_map_camera, seen); }

  SlamSettings settings;
  Map map;
  std::vector<LandmarkId> landmarks;
  ReferenceKeyframe reference{settings};
  KeyframeId id = kNoKeyframe;
};

TEST_F(Reference, IsOutgrownByDistanceOverDepthOrByTurn) {
  EXPECT_FALSE(due(moved(0.29)));
  EXPECT_TRUE(due(moved(0.31)));
  EXPECT_FALSE(due(moved(0, 0.19)));
  EXPECT_TRUE(due(moved(0, -0.21)));
}

TEST_F(Reference, IsOutgrownByLandmarksLostFromAnotherPlace) {
  EXPECT_FALSE(due(moved(0.1), 56));
  EXPECT_TRUE(due(moved(0.1), 54));
  EXPECT_FALSE(due(moved(0.05), 81)) << "most are still seen";
  // From the same place nothing new is seen, unless many landmarks were lost.
  EXPECT_TRUE(due(moved(0.05), 54));
  for (int i = 50; i < 100; ++i) map.disconnect(id, i);
  EXPECT_FALSE(due(moved(0.05), 44)) << "of the 50 that the keyframe sees itself";
  EXPECT_TRUE(due(moved(0.1), 44)) << "fewer than three times what a pose needs";
}

TEST_F(Reference, LastsSomeFrames) {
  reference.set(map, id);
  reference.countFrame();
  reference.countFrame();
  EXPECT_FALSE(due(moved(1)));
  reference.countFrame();
  EXPECT_TRUE(due(moved(1)));
  reference.reset();
  EXPECT_EQ(reference.id(), kNoKeyframe);
}

TEST_F(Reference, LastsEverLongerWhereTheViewOfOneThatStandsChanges) {
  const auto lasted = [&] {
    int frames = 0;
    for (; !due(moved(0.02), 40); ++frames) reference.countFrame();
    return frames;
  };
  EXPECT_EQ(lasted(), 0);
  for (const int expected : {3, 3, 6, 12, 24, 48}) {
    reference.set(map, add(moved(0.01)));
    EXPECT_EQ(lasted(), expected);
  }
  for (int i = 0; i < 192; ++i) reference.countFrame();
  reference.set(map, add(moved(0.01)));
  EXPECT_EQ(lasted(), 24) << "it has been quiet";
  EXPECT_TRUE(due(moved(0.5), 100));
  reference.set(map, add(moved(0.5)));
  for (int i = 0; i < 3; ++i) reference.countFrame();
  EXPECT_TRUE(due(moved(0.52), 40)) << "another place";
}

TEST_F(Reference, AnEarlierKeyframeOfThatViewServesAgain) {
  const KeyframeId second = add(moved(1));
  visual_frontend::LandmarkTracks tracks;
  const auto track = [&](int count) {
    tracks.clear();
    for (int i = 0; i < count; ++i) tracks.assign(i, landmarks[i]);
  };
  track(100);
  EXPECT_EQ(reference.ofView(map, tracks, moved(0.05), 100), id);
  EXPECT_EQ(reference.ofView(map, tracks, moved(0.95), 100), second);
  EXPECT_EQ(reference.ofView(map, tracks, moved(0.5), 100), kNoKeyframe);
  track(2 * settings.min_inliers - 1);
  EXPECT_EQ(reference.ofView(map, tracks, moved(0.05), 100), kNoKeyframe) << "there may be a loop to close";
}

TEST_F(Reference, ASmallShareOfAViewAwayIsTheSamePlace) {
  EXPECT_TRUE(reference.same(map, id, add(moved(0.07))));
  EXPECT_FALSE(reference.same(map, id, add(moved(0.08))));
  EXPECT_TRUE(reference.same(map, id, add(moved(0, 0.045))));
  EXPECT_FALSE(reference.same(map, id, add(moved(0, 0.055))));
}

/// What a robot that stands sees of a bare floor with two spots, and of somebody in a coat with a pattern who sways 1 m
/// before it: he leaves one of the spots to be seen.
struct Visitor {
  Visitor(const cv::Size& spot, const cv::Size& pattern) : coat(480, 352, CV_8U, cv::Scalar(90)) {
    robot.rest = 1e3;
    robot.mounting.T_base_camera.linear() = Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX()).toRotationMatrix();
    const cv::Rect at({180, 200}, pattern);
    simulated::synthetic::texture(900, 21)(at).copyTo(coat(at));
    simulated::synthetic::Random random(2);
    for (int i = 0; i < 4; ++i) {
      const auto seen = robot.frame(0.1 * i, random);
      cv::Mat bare(seen.gray.size(), CV_8U, cv::Scalar(120));
      for (const cv::Rect& shown : {cv::Rect({540, 200}, spot), cv::Rect(250, 200, 150, 150)})
        seen.gray(shown).copyTo(bare(shown));
      views.push_back({bare, seen.depth});
    }
  }
  simulated::Robot::Frame view(int i) const {
    simulated::Robot::Frame frame{views[i % views.size()].gray.clone(), views[i % views.size()].depth.clone()};
    if (i < 60) return frame;
    const cv::Rect body(140 + static_cast<int>(std::lround(30 * std::sin(2 * M_PI * i / 45))), 0, 352, 480);
    coat.copyTo(frame.gray(body));
    frame.depth(body).setTo(1.0F);
    return frame;
  }

  static constexpr int kFrames = 660;
  simulated::Robot robot;
  cv::Mat coat;
  std::vector<simulated::Robot::Frame> views;
};

TEST(Keyframes, SomebodyWhoMovesBeforeARobotThatStandsMakesFew) {
  for (const int spot : {260, 190}) {  // some 33 and 27 landmarks
    const Visitor visitor({95, spot}, {120, 115});
    Slam slam(visitor.robot.camera, visitor.robot.mounting, {});
    simulated::synthetic::Random random(7);
    double next_imu = 0;
    int tracked = 0;
    for (int i = 0; i < Visitor::kFrames; ++i) {
      const double t = i / 30.0;
      for (; next_imu <= t + 0.005; next_imu += 0.005) slam.addImu(visitor.robot.imu(next_imu, random));
      const auto frame = visitor.view(i);
      const SlamResult r = slam.process(t, frame.gray, cv::Mat(), frame.depth);
      tracked += r.state == State::kTracking;
    }
    EXPECT_EQ(slam.mapId(), 1);
    EXPECT_LE(slam.counters().keyframes, 25) << spot;
    EXPECT_LE(slam.map().keyframeCount(), 15u) << spot;
    EXPECT_GT(tracked, Visitor::kFrames - 10) << spot;
  }
}

}  // namespace
}  // namespace rgbd_slam
