// The node with synthetic messages: what comes out, and what it does with a looped bag, gaps and bad input.
#include <cstdio>

#include "node_fixture.h"

namespace ekf_tracker::test {
namespace {

TEST_F(EkfTrackerNodeTest, FollowsTheTruthOnOdometryTfAndGeodetic) {
  using I = air_ground::TrackerInnovation;
  fly(0, 40);
  ASSERT_TRUE(reach(40));
  fixes_.publish(fix(10, {0.3, 0, 0}));  // late by a second and a half
  ASSERT_TRUE(spinUntil([&] { return results(I::RESULT_WAITING) == 1; }));
  fly(40, 60);
  ASSERT_TRUE(reach(60));
  fixes_.publish(fix(30, {-0.3, 0.2, 0}));
  ASSERT_TRUE(spinUntil([&] { return results(I::RESULT_INITIALISED) == 1 && results(I::RESULT_AGREED) == 1; }));
  EXPECT_TRUE(tracked_.empty());  // nothing was claimed before
  for (const auto& m : innovations_) {
    if (m.source != I::SOURCE_FIX) continue;
    EXPECT_EQ(m.dof, 4);
    EXPECT_NEAR(m.gate, 16.25, 0.01);
    EXPECT_NEAR(m.delay, 1.5, 1e-3);
    EXPECT_EQ(m.revised, m.result == I::RESULT_AGREED);
  }
  fly(60, 200);
  fixes_.publish(fix(190));
  ASSERT_TRUE(spinUntil([&] { return results(I::RESULT_FUSED) == 1; }));
  fly(200, 240);
  expectOnTheWay(240, 1.0);
  EXPECT_EQ(tracked_.back().header.frame_id, "world");
  EXPECT_EQ(tracked_.back().child_frame_id, "mav_base_link");
  // The tilt stays in; the twist is the body's.
  const Eigen::Vector3d moved = (mapPose(239).inverse() * mapPose(240)).translation() / kStep;
  EXPECT_NEAR(tracked_.back().twist.twist.linear.x, moved.x(), 0.1);
  EXPECT_NEAR(tracked_.back().twist.twist.linear.z, moved.z(), 0.1);
  const auto spread = ru::covarianceFromMsg(tracked_.back().twist.covariance);
  EXPECT_GT(spread(0, 0), 1e-4 / (kStep * kStep));  // of the increment, and some of the scale
  EXPECT_LT(spread(0, 0), 3e-4 / (kStep * kStep));
  EXPECT_NEAR(spread(5, 5), (1e-6 + 1e-8) / (kStep * kStep), 1e-6);
  EXPECT_GE(spread(3, 3), 1e6);  // never measured
  // The path comes once a second, not with each of its poses.
  ASSERT_TRUE(spinUntil([&] { return !paths_.empty() && paths_.back().poses.size() > 30; }));
  EXPECT_LE(paths_.size(), 11u);

  // A pose whose odometry comes too late has no edge: the next one does.
  int at = 240;
  ASSERT_TRUE(spinUntil([&] {
    if (!edges_.empty() && edges_.back().header.stamp == tracked_.back().header.stamp) return true;
    fly(at, at + 1);
    return ++at, false;
  }));
  EXPECT_EQ(edges_.back().header.frame_id, "world");
  const int step = static_cast<int>(std::lround((edges_.back().header.stamp - timeOf(0)).toSec() / kStep));
  const Pose T_world_base = ru::fromMsg(edges_.back().transform) * mapPose(step);
  EXPECT_LT((T_world_base.matrix() - ru::fromMsg(tracked_.back().pose.pose).matrix()).norm(), 1e-6);
  EXPECT_NEAR(ru::fromMsg(edges_.back().transform).linear()(2, 2), 1, 1e-12);  // level
  for (std::size_t i = 1; i < edges_.size(); ++i) EXPECT_GT(edges_[i].header.stamp, edges_[i - 1].header.stamp);

  ASSERT_TRUE(awaitStamp(at));
  ASSERT_TRUE(spinUntil([&] { return geodetic_.header.stamp == tracked_.back().header.stamp; }));
  const Pose published = ru::fromMsg(tracked_.back().pose.pose);
  const air_ground_common::LocalFrame frame("EPSG:2056", {2683300, 1247900, 420});
  EXPECT_LT((frame.fromGeodetic({geodetic_.latitude, geodetic_.longitude, geodetic_.altitude - 47.3}) -
             published.translation())
                .norm(),
            1e-3);
  EXPECT_NEAR(geodetic_.altitude, 420 + 47.3 + published.translation().z(), 0.1);
  expectFinite();

  air_ground::SaveTrajectory save;
  save.request.path = ros::names::clean("/tmp/ekf_tracker_node_test.tum");
  ASSERT_TRUE(callService("ekf_tracker/save_trajectory", save));
  EXPECT_TRUE(save.response.success) << save.response.message;
  EXPECT_EQ(air_ground_common::readTum(save.request.path).size(), save.response.poses);
  std::remove(save.request.path.c_str());
}

TEST_F(EkfTrackerNodeTest, BadFixesAreRefusedCountedAndHarmless) {
  fly(0, 20);
  ASSERT_TRUE(giveFixes({0, 5, 10}));
  fly(20, 100);
  ASSERT_TRUE(awaitStamp(100));
  innovations_.clear();
  auto bad = fix(90);
  bad.pose.covariance[0] = kNan;
  fixes_.publish(bad);
  bad = fix(91);
  bad.pose.pose.position.y = kNan;
  fixes_.publish(bad);
  bad = fix(92);
  bad.pose.pose.orientation.w = bad.pose.pose.orientation.z = bad.pose.pose.orientation.x =
      bad.pose.pose.orientation.y = 0;
  fixes_.publish(bad);
  bad = fix(93);
  bad.pose.covariance[0] = -1;
  fixes_.publish(bad);
  bad = fix(94);
  bad.header.frame_id = "map";
  fixes_.publish(bad);
  bad = fix(95);
  bad.header.stamp += ros::Duration(500);  // from the future
  fixes_.publish(bad);
  bad.header.stamp.sec = bad.header.stamp.nsec = 0xFFFFFFFFu;  // not set: too late to be told in seconds
  fixes_.publish(bad);
  bad = fix(0);
  bad.header.stamp -= ros::Duration(500);  // long past
  fixes_.publish(bad);
  fixes_.publish(fix(96, {60, 0, 0}));  // a gross outlier
  fixes_.publish(fix(80));              // older than those before
  fixes_.publish(fix(80));              // and again
  using I = air_ground::TrackerInnovation;
  EXPECT_TRUE(spinUntil([&] { return results(I::RESULT_DUPLICATE) == 1; }));
  EXPECT_EQ(results(I::RESULT_INVALID), 4);
  EXPECT_EQ(results(I::RESULT_FROM_FUTURE), 1);
  EXPECT_EQ(results(I::RESULT_TOO_OLD), 1);
  EXPECT_EQ(results(I::RESULT_REFUSED_BY_GATE), 1);
  EXPECT_EQ(results(I::RESULT_FUSED), 1);
  for (const auto& m : innovations_) EXPECT_TRUE(std::isfinite(m.nis));
  EXPECT_TRUE(diagnostics_.await("fix: too far ahead of the odometry", 2));
  EXPECT_TRUE(diagnostics_.await("fix: outside the gate", 1));
  EXPECT_TRUE(diagnostics_.await("fix: not finite, or its covariance is not positive definite", 4));
  EXPECT_TRUE(diagnostics_.await("fixes ignored: in frame 'map', expected 'world'", 1));
  fly(100, 140);
  expectOnTheWay(140, 1.0);
  expectFinite();
}

TEST_F(EkfTrackerNodeTest, BadOdometryGapsAndRepetitionsAreSurvived) {
  fly(0, 60);
  ASSERT_TRUE(giveFixes({10, 30, 50}));
  fly(60, 100);
  ASSERT_TRUE(awaitStamp(100));
  auto bad = increment(99, 100);
  increments_.publish(bad);  // repeated
  bad = increment(85, 86);
  increments_.publish(bad);              // out of order, by less than what a looped bag jumps
  increments_.publish(increment(5, 6));  // a stray from long ago is no looped bag
  bad = increment(100, 101);
  bad.header.stamp = ros::Time::now() + ros::Duration(100);
  bad.previous_stamp = bad.header.stamp - ros::Duration(kStep);
  increments_.publish(bad);  // from the future
  bad = increment(100, 101);
  bad.relative_pose.position.x = kNan;
  increments_.publish(bad);
  bad = increment(100, 101);
  bad.covariance[0] = kNan;
  increments_.publish(bad);
  nav_msgs::Odometry vo;
  vo.header.stamp = timeOf(101);
  vo.header.frame_id = "mav_map";
  vo.pose.pose = ru::toMsg(mapPose(101));
  vo_.publish(vo);
  fly(101, 160);
  ASSERT_TRUE(awaitStamp(160));
  for (std::size_t i = 1; i < tracked_.size(); ++i) EXPECT_LT(tracked_[i].pose.covariance[0], 2);  // no gap was bridged
  EXPECT_EQ(results(air_ground::TrackerInnovation::RESULT_INITIALISED), 1);
  const double before = tracked_.back().pose.covariance[0];
  // Ten seconds of silence, with tracked map poses on the other side.
  fly(360, 380);
  ASSERT_TRUE(awaitStamp(380));
  EXPECT_GT(tracked_.back().pose.covariance[0], before + 100);
  EXPECT_TRUE(diagnostics_.await("gaps in the odometry, bridged", 1));
  EXPECT_TRUE(diagnostics_.await("increments ignored: out of order or repeated", 1));
  EXPECT_TRUE(diagnostics_.await("increments ignored: stamped ahead of the clock", 1));
  EXPECT_TRUE(diagnostics_.await("increments set aside: more than a second older than the newest", 1));
  EXPECT_TRUE(diagnostics_.await("increments whose covariance is not one: the default stands in", 1));
  ASSERT_TRUE(giveFixes({365, 370, 378}));
  fly(380, 420);
  expectOnTheWay(420, 1.5);
  expectFinite();
}

// The match of a fix's stamp, which comes after it here, tells the panorama: three wrong fixes of one replace nothing.
TEST_F(EkfTrackerNodeTest, MatchesTellWhichPanoramaAFixRestsOn) {
  using I = air_ground::TrackerInnovation;
  ros::Publisher matches = handle_.advertise<air_ground::StreetviewMatch>("streetview/match", 100);
  ASSERT_TRUE(spinUntil([&] { return matches.getNumSubscribers() > 0; }));
  const auto give = [&](int i, const std::string& panorama, const Eigen::Vector3d& error) {
    const int before = answered();
    fixes_.publish(fix(i, error));
    ros::WallDuration(0.005).sleep();  // by the wall clock the fix waits for 0.3 s
    air_ground::StreetviewMatch match;
    match.header.stamp = timeOf(i);
    match.status = air_ground::StreetviewMatch::STATUS_ACCEPTED;
    match.panorama_id = panorama;
    matches.publish(match);
    return spinUntil([&] { return answered() > before; });
  };
  fly(0, 200);
  ASSERT_TRUE(reach(200));
  for (int i = 10; i <= 120; i += 10) ASSERT_TRUE(give(i, i < 60 ? "a.jpg" : "b.jpg", Eigen::Vector3d::Zero())) << i;
  ASSERT_GT(results(I::RESULT_FUSED), 4);
  for (int i = 140; i <= 180; i += 20) ASSERT_TRUE(give(i, "c.jpg", {30, 0, 0})) << i;
  EXPECT_EQ(results(I::RESULT_REFUSED_BY_GATE), 3);
  EXPECT_EQ(results(I::RESULT_RECOVERED), 0);
  fly(200, 220);
  expectOnTheWay(220, 1.0);
  ASSERT_TRUE(give(210, "d.jpg", {30, 0, 0}));
  EXPECT_TRUE(spinUntil([&] { return results(I::RESULT_RECOVERED) == 1; }));
}

TEST_F(EkfTrackerNodeTest, LoopedBagStartsAfresh) {
  for (int round = 0; round < 2; ++round) {
    fly(0, 60);
    fixes_.publish(fix(20));
    fixes_.publish(fix(40));
    ASSERT_TRUE(spinUntil([&] { return results(air_ground::TrackerInnovation::RESULT_INITIALISED) == round + 1; }))
        << round;
    fly(60, 120);
    ASSERT_TRUE(spinUntil([&] { return !tracked_.empty() && tracked_.back().header.stamp == timeOf(120); }));
    expectOnTheWay(120, 1.0);
    tracked_.clear();
  }
  EXPECT_TRUE(diagnostics_.await("time jumped back: started afresh", 1));
}

TEST_F(EkfTrackerNodeTest, DiagnosticsTellThatTheOdometryDied) {
  fly(0, 60);
  ASSERT_TRUE(giveFixes({10, 30, 50}));
  fly(60, 100);
  ASSERT_TRUE(awaitStamp(100));
  EXPECT_TRUE(spinUntil([&] { return diagnostics_.message().find("no usable visual odometry") == 0; }))
      << diagnostics_.message();
  EXPECT_EQ(diagnostics_.level(), diagnostic_msgs::DiagnosticStatus::ERROR);
  const std::size_t before = keptTrajectories();
  ASSERT_TRUE(reset());
  EXPECT_EQ(keptTrajectories(), before + 1) << "the trajectory so far is lost";
  EXPECT_TRUE(spinUntil([&] { return diagnostics_.message().find("forgot the pose") == 0; })) << diagnostics_.message();
  EXPECT_NE(diagnostics_.level(), diagnostic_msgs::DiagnosticStatus::OK);
}

// Two machines whose clocks are apart: its odometry comes, but none of it can be used.
TEST_F(EkfTrackerNodeTest, OdometryAheadOfTheClockIsNamedUntilTheClocksAgree) {
  const auto says = [&](const std::string& line) {
    return spinUntil([&] { return diagnostics_.message().find(line) == 0; });
  };
  const auto ahead = [&] {
    auto m = increment(0, 1);
    m.header.stamp = ros::Time::now() + ros::Duration(60);
    increments_.publish(m);
  };
  // By the time when it is heard, which on a busy machine is later.
  const auto saysAhead = [&] {
    return spinUntil([&] {
      double seconds = 0;
      const std::string& line = diagnostics_.message();
      return std::sscanf(line.c_str(), "visual odometry is stamped %lf s ahead", &seconds) == 1 && seconds > 30 &&
             seconds <= 60 && line.find(" s ahead of this machine's clock") != std::string::npos;
    });
  };
  ahead();
  EXPECT_TRUE(saysAhead()) << diagnostics_.message();
  EXPECT_EQ(diagnostics_.level(), diagnostic_msgs::DiagnosticStatus::ERROR);
  fly(0, 60);
  ASSERT_TRUE(giveFixes({10, 30, 50}));
  int at = 60;
  // It flies on meanwhile: a second after the last increment it would tell that the odometry is lost.
  EXPECT_TRUE(spinUntil([&] {
    fly(at, at + 1);
    return ++at, diagnostics_.message().find("tracking: ") == 0;
  })) << diagnostics_.message();
  ahead();  // one among good ones
  EXPECT_TRUE(says("no usable visual odometry")) << diagnostics_.message();
  ahead();
  EXPECT_TRUE(saysAhead()) << diagnostics_.message();
}

TEST_F(EkfTrackerNodeTest, OdometryOfForeignFramesGivesNoTf) {
  const auto flyIn = [&](const std::string& map, const std::string& base) {
    ASSERT_TRUE(reset());
    tracked_.clear();
    edges_.clear();
    fly(0, 60, map, base);
    fixes_.publish(fix(20));
    fixes_.publish(fix(40));
    ASSERT_TRUE(spinUntil([&] { return results(air_ground::TrackerInnovation::RESULT_INITIALISED) > 0; }));
    innovations_.clear();
    fly(60, 80, map, base);
    ASSERT_TRUE(awaitStamp(80));  // each increment after its wait
  };
  flyIn("mav_odom", "mav_base_link");
  EXPECT_TRUE(edges_.empty());
  EXPECT_TRUE(diagnostics_.await("mav/odometry ignored: in frame 'mav_odom', expected map_frame 'mav_map'", 80));
  flyIn("mav_map", "mav_camera");
  EXPECT_TRUE(edges_.empty());
  EXPECT_TRUE(
      diagnostics_.await("mav/odometry ignored: of frame 'mav_camera', expected base_frame 'mav_base_link'", 80));
}

}  // namespace
}  // namespace ekf_tracker::test

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "ekf_tracker_node_test");
  return RUN_ALL_TESTS();
}
