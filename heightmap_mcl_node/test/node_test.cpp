// The node as other nodes see it: frames, order of inputs, bad input, services, looped time, refusal. Outputs of an
// earlier test are told by their stamps.
#include <rosgraph_msgs/Log.h>

#include "node_fixture.h"

TEST_F(NodeTest, GroundMapThatComesLateTriggersTheSearchAndTheChainConverges) {
  const auto run = world(601, 8);
  for (int k = 0; k < 3; ++k) {
    stamp_ += ros::Duration(2);
    sendOdometry(run.aerial[k].reference, stamp_ - ros::Duration(0.05));
    sendOdometry(run.aerial[k].reference, stamp_ + ros::Duration(0.05));
    cloud_.publish(cloudMsg(run.aerial[k].points, "mav_map", stamp_));
  }
  ASSERT_TRUE(spinUntil([&] { return air_.messages.size() >= 3; }));
  for (const auto& e : coarse_.messages) EXPECT_EQ(e.status, AlignmentEstimate::STATUS_SEARCHING);
  ASSERT_TRUE(sendGround(run));
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty() && coarse_.messages.back().overlap > 0; }));
  EXPECT_EQ(last().header.stamp, stamp_);
  for (int k = 3; k < 8; ++k) ASSERT_TRUE(sendAerial(run.aerial[k]));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  for (const auto& e : coarse_.messages) expectSane(e);
  const auto error =
      syn::errorOf(ros_utils::fromMsg(last().pose.pose), run.T_ground_mav.back(), run.aerial.back().reference);
  EXPECT_LT(error.position, 0.2);
  EXPECT_LT(error.yaw, 0.05);

  ASSERT_TRUE(spinUntil([&] {
    return !particles_.messages.empty() && particles_.messages.back().header.stamp == stamp_ &&
           !costmap_.messages.empty() && costmap_.messages.back().header.stamp == stamp_ &&
           !ground_map_.messages.empty();
  }));
  const auto& particles = particles_.messages.back();
  EXPECT_EQ(particles.header.frame_id, "ground_map");
  ASSERT_EQ(particles.poses.size(), 200u);
  // The particles are poses of the MAV, whose height they share.
  const Eigen::Vector3d mav = run.T_ground_mav.back() * run.aerial.back().reference;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& p : particles.poses) mean += ros_utils::fromMsg(p).translation() / 200;
  EXPECT_LT((mean - mav).norm(), 0.4);
  const auto& air = air_.messages.back();
  EXPECT_EQ(air.header.frame_id, "mav_map");
  EXPECT_EQ(air.heights.size(), static_cast<std::size_t>(air.width) * air.height);
  EXPECT_EQ(ground_map_.messages.back().header.frame_id, "ground_map");
  const auto& grid = costmap_.messages.back();
  EXPECT_EQ(grid.header.frame_id, "ground_map");
  ASSERT_EQ(grid.data.size(), static_cast<std::size_t>(grid.info.width) * grid.info.height);
  // The best cell of the cost map lies at the MAV's position.
  const auto best = static_cast<int>(std::find(grid.data.begin(), grid.data.end(), 0) - grid.data.begin());
  ASSERT_LT(best, static_cast<int>(grid.data.size()));
  const double x = grid.info.origin.position.x + (best % grid.info.width + 0.5) * grid.info.resolution;
  const double y = grid.info.origin.position.y + (best / grid.info.width + 0.5) * grid.info.resolution;
  EXPECT_LT(std::hypot(x - mav.x(), y - mav.y()), 0.4);
}

TEST_F(NodeTest, SurvivesBadInput) {
  const auto run = world(602, 2);
  const float nan = std::nanf("");
  ASSERT_TRUE(sendGround(run));
  cloud_.publish(cloudMsg({}, "mav_map", stamp_ += ros::Duration(1)));
  cloud_.publish(cloudMsg({{nan, nan, nan}, {nan, 0, 0}}, "mav_map", stamp_ += ros::Duration(1)));
  cloud_.publish(cloudMsg(run.aerial[0].points, "elsewhere", stamp_ += ros::Duration(1)));
  sensor_msgs::PointCloud2 broken = cloudMsg(run.aerial[0].points, "mav_map", stamp_ += ros::Duration(1));
  broken.data.resize(100);
  cloud_.publish(broken);
  broken.fields.clear();
  cloud_.publish(broken);
  ground_.publish(cloudMsg({}, "ground_map", stamp_));
  // Each kind of bad input has its counter.
  for (const char* event :
       {"aerial clouds without a finite point", "points of aerial clouds that are not finite",
        "aerial clouds in frame 'elsewhere'", "aerial clouds unreadable", "ground clouds without a point"}) {
    EXPECT_TRUE(diagnostics_.await(event, 1)) << event;
  }
  for (const auto& e : coarse_.messages) {
    expectSane(e);
    EXPECT_EQ(e.status, AlignmentEstimate::STATUS_SEARCHING);
  }
  auto with_holes = run.aerial[0];
  for (std::size_t i = 0; i < with_holes.points.size(); i += 7) with_holes.points[i].z() = nan;
  ASSERT_TRUE(sendAerial(with_holes));
  EXPECT_GT(last().overlap, 0.4);
  expectSane(last());
  // No odometry at the cloud's stamp: it is used nevertheless.
  stamp_ += ros::Duration(3);
  cloud_.publish(cloudMsg(run.aerial[1].points, "mav_map", stamp_));
  EXPECT_TRUE(spinUntil([&] { return last().header.stamp == stamp_; }));
  expectSane(last());
  EXPECT_TRUE(diagnostics_.await("aerial clouds without odometry", 1));
}

TEST_F(NodeTest, SaysWhichPartOfALargeGroundMapIsSearched) {
  std::vector<std::string> warnings;
  const ros::Subscriber console =
      node_.subscribe<rosgraph_msgs::Log>("/rosout", 100, [&](const rosgraph_msgs::Log::ConstPtr& m) {
        if (m->level == rosgraph_msgs::Log::WARN && m->name == "/heightmap_mcl") warnings.push_back(m->msg);
      });
  ASSERT_TRUE(spinUntil([&] { return console.getNumPublishers() >= 4; })) << "the nodes of the launch file, and this";
  std::vector<Eigen::Vector3f> points;
  for (float x = -20; x <= 40; x += x < 10 ? 0.05f : 0.2f)  // a gallery, densest at its begin
    for (float y = 0; y <= 4; y += 0.1f) points.emplace_back(x, y, 0);
  ground_.publish(cloudMsg(points, "ground_map", stamp_));
  ASSERT_TRUE(spinUntil([&] { return !ground_map_.messages.empty(); }));
  EXPECT_NEAR(ground_map_.messages.back().width * ground_map_.messages.back().resolution, 40, 8);
  const auto says = [&](const std::string& part) {
    return std::any_of(warnings.begin(), warnings.end(),
                       [&](const std::string& line) { return line.find(part) != std::string::npos; });
  };
  ASSERT_TRUE(spinUntil([&] { return says("the ground cloud of 60 x 4 m is larger than ground/max_extent (40 m)"); }));
  EXPECT_TRUE(says("only where it is densest, x -20 to ")) << warnings.back();
  EXPECT_TRUE(says("Raise ground/max_extent"));
}

TEST_F(NodeTest, ACloudThatOvertakesItsOdometryWaitsForIt) {
  const auto run = world(602, 1);
  const std::string without = "aerial clouds without odometry";
  ASSERT_TRUE(sendGround(run));
  int in_time = 0, waited = 0;
  for (int attempt = 0; attempt < 20 && in_time < 5; ++attempt) {
    ASSERT_TRUE(diagnostics_.refresh());
    const int before = diagnostics_.counted(without);
    stamp_ += ros::Duration(2);
    const ros::WallTime begin = ros::WallTime::now();
    cloud_.publish(cloudMsg(run.aerial[0].points, "mav_map", stamp_));
    ros::WallDuration(0.05).sleep();  // once: each time that it wakes a busy machine may be late
    sendOdometry(run.aerial[0].reference, stamp_ - ros::Duration(0.05));
    sendOdometry(run.aerial[0].reference, stamp_ + ros::Duration(0.05));
    // The node waits for 0.3 s, by the wall clock: an attempt in which this process slept tells nothing.
    const bool prompt = (ros::WallTime::now() - begin).toSec() < 0.15;
    ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty() && last().header.stamp == stamp_; }));
    ASSERT_TRUE(diagnostics_.refresh());
    if (!prompt) continue;
    ++in_time;
    waited += diagnostics_.counted(without) == before;
  }
  ASSERT_GE(in_time, 2);
  EXPECT_GE(waited, in_time - 1);  // the node may sleep once as well
}

TEST_F(NodeTest, CloudsThatWaitAreSearchedTogetherOnceItIsConverged) {
  const auto run = world(601, 8);
  ASSERT_TRUE(sendGround(run));
  for (int k = 0; k < 8; ++k) ASSERT_TRUE(sendAerial(run.aerial[k]));
  ASSERT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  const std::uint32_t maps = last().iterations;
  coarse_.messages.clear();
  // Faster than one search each.
  constexpr int kClouds = 8;
  for (int k = 0; k < kClouds; ++k) {
    stamp_ += ros::Duration(0.5);
    sendOdometry(run.aerial[k].reference, stamp_ - ros::Duration(0.05));
    sendOdometry(run.aerial[k].reference, stamp_ + ros::Duration(0.05));
    cloud_.publish(cloudMsg(run.aerial[k].points, "mav_map", stamp_));
  }
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty() && last().header.stamp == stamp_; }));
  EXPECT_EQ(last().iterations, maps + kClouds) << "none is lost";
  EXPECT_LT(coarse_.messages.size(), static_cast<std::size_t>(kClouds));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
}

TEST_F(NodeTest, TheSameCloudTwiceIsNoMoreEvidence) {
  const auto run = world(604, 3);
  ASSERT_TRUE(sendGround(run));
  ASSERT_TRUE(sendAerial(run.aerial[0]));
  EXPECT_EQ(last().iterations, 1u);
  const auto first = cloudMsg(run.aerial[0].points, "mav_map", stamp_);
  ASSERT_TRUE(diagnostics_.refresh());
  const int before = diagnostics_.counted("aerial clouds repeated");
  cloud_.publish(first);
  ASSERT_TRUE(diagnostics_.await("aerial clouds repeated", before + 1));
  ASSERT_TRUE(sendAerial(run.aerial[1]));
  EXPECT_EQ(last().iterations, 2u);
  // Whoever subscribes again gets what came before once more: no jump of time.
  cloud_.publish(first);
  ASSERT_TRUE(diagnostics_.await("aerial clouds repeated", before + 2));
  ASSERT_TRUE(sendAerial(run.aerial[2]));
  EXPECT_EQ(last().iterations, 3u);
}

TEST_F(NodeTest, CloudsInTheirOwnUnitDoNotWaitForMetricOdometry) {
  const auto run = world(604, 3);
  // As after a respawn: mav_vo has become metric before, its clouds stay in their unit.
  sendOdometry(run.aerial[0].reference, stamp_);
  pause(20);
  for (const auto& cloud : run.aerial) {
    stamp_ += ros::Duration(8);
    cloud_.publish(cloudMsg(cloud.points, "mav_visual_map", stamp_));
    ASSERT_TRUE(spinUntil([&] { return !air_.messages.empty() && air_.messages.back().header.stamp == stamp_; }));
  }
}

TEST_F(NodeTest, LoopedTimeStartsAfresh) {
  const auto run = world(603, 6);
  const ros::Time begin = stamp_;
  ASSERT_TRUE(sendGround(run));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  EXPECT_GE(last().iterations, 6u);
  ASSERT_TRUE(diagnostics_.refresh());
  const std::string too_late = "aerial clouds later than the odometry by more than 5 s dropped";
  const int dropped = diagnostics_.counted(too_late);
  // The bag begins again: the MAV's part shows it first.
  const ros::Time late = stamp_ + ros::Duration(1);
  stamp_ = begin - ros::Duration(100);
  clear();
  sendOdometry(run.aerial[0].reference, stamp_);
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty(); }));
  EXPECT_EQ(last().overlap, 0);
  // A cloud that was still on its way enters nothing, and starts nothing afresh.
  clear();
  cloud_.publish(cloudMsg(run.aerial[5].points, "mav_map", late));
  EXPECT_TRUE(diagnostics_.await(too_late, dropped + 1));
  EXPECT_TRUE(coarse_.messages.empty());
  ASSERT_TRUE(sendGround(run));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  EXPECT_EQ(last().iterations, 6u);
  EXPECT_GT(last().overlap, 0.4);
}

TEST_F(NodeTest, GroundMapOutlivesResetAndTheMavsClock) {
  const auto run = world(607, 2);
  ASSERT_TRUE(sendGround(run));  // once, latched: the ground robot stands still
  ASSERT_TRUE(sendAerial(run.aerial[0]));
  ASSERT_GT(last().overlap, 0);
  stamp_ -= ros::Duration(500);
  ASSERT_TRUE(sendAerial(run.aerial[0]));
  EXPECT_GT(last().overlap, 0);
  EXPECT_EQ(last().iterations, 1u);
  ASSERT_TRUE(call("heightmap_mcl/reset"));
  ground_map_.messages.clear();
  ASSERT_TRUE(spinUntil([&] { return !ground_map_.messages.empty(); }));
  ASSERT_TRUE(sendAerial(run.aerial[1]));
  EXPECT_GT(last().overlap, 0);
}

TEST_F(NodeTest, FreshGroundMapStartsTheSearchAgain) {
  const auto run = world(601, 8), other = world(608, 1);
  sendGroundStatus(1);
  ASSERT_TRUE(sendGround(run));
  const ros::Time sent = stamp_;
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  ASSERT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  EXPECT_EQ(ground_map_.messages.back().header.stamp, sent);
  clear();
  ASSERT_TRUE(diagnostics_.refresh());
  const std::string earlier = "ground clouds of an earlier map dropped";
  const int before = diagnostics_.counted(earlier);
  sendGroundStatus(2);
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty(); }));
  // The old map, latched still, does not come back.
  EXPECT_TRUE(diagnostics_.await(earlier, before + 1));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_SEARCHING) << last().reason;
  EXPECT_EQ(last().overlap, 0);
  EXPECT_GE(last().pose.covariance[0], 1e6);
  clear();
  ASSERT_TRUE(sendGround(other));
}

TEST_F(TfNodeTest, PublishesTfOnlyWhileConverged) {
  const auto run = world(601, 8);
  sendStatus(1);
  ASSERT_TRUE(sendGround(run));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  ASSERT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  ASSERT_TRUE(spinUntil([&] { return tf_.messages.size() > 2; }));
  EXPECT_EQ(tf_.messages.back().transforms[0].child_frame_id, "mav_map");
  clear();
  stamp_ += ros::Duration(1);
  sendStatus(2);
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty(); }));
  const ros::Time told = ros::Time::now();
  pause(200);
  for (const auto& m : tf_.messages) EXPECT_LT(m.transforms[0].header.stamp, told);
  EXPECT_TRUE(tf_static_.messages.empty());
}

TEST_F(NodeTest, FreshMapOfTheMavAndRelocalizeStartTheSearchAgain) {
  const auto run = world(604, 6);
  ASSERT_TRUE(sendGround(run));
  sendStatus(3);
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  EXPECT_EQ(last().map_id, 3u);
  const std::size_t before = coarse_.messages.size();
  ASSERT_TRUE(call("heightmap_mcl/relocalize"));
  ASSERT_TRUE(spinUntil([&] { return coarse_.messages.size() > before; }));
  EXPECT_GT(last().overlap, 0.4);  // on the maps at hand
  clear();
  stamp_ += ros::Duration(1);
  sendStatus(4);
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty(); }));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_SEARCHING);
  EXPECT_EQ(last().map_id, 4u);
  EXPECT_EQ(last().overlap, 0);
  ASSERT_TRUE(sendAerial(run.aerial[0]));
  EXPECT_EQ(last().iterations, 1u);
}

// The MAV scouted here and flew on; then the ground robot comes.
TEST_F(NodeTest, CloudsThatTheMavHasLeftBehindAreSearchedWhileNothingElseIsToBeDone) {
  const auto run = world(4, 8), other = world(9, 8);
  const auto fly = [&](const heightmap_mcl::AerialCloud& cloud) {
    const std::size_t before = air_.messages.size();
    stamp_ += ros::Duration(2);
    sendOdometry(cloud.reference, stamp_ - ros::Duration(0.05));
    sendOdometry(cloud.reference, stamp_ + ros::Duration(0.05));
    cloud_.publish(cloudMsg(cloud.points, "mav_map", stamp_));
    return spinUntil([&] { return air_.messages.size() > before; });
  };
  for (const auto& cloud : run.aerial) ASSERT_TRUE(fly(cloud));
  const ros::Time left = stamp_;
  for (heightmap_mcl::AerialCloud cloud : other.aerial) {
    for (auto& p : cloud.points) p.x() += 60;
    cloud.reference.x() += 60;
    ASSERT_TRUE(fly(cloud));
  }
  coarse_.messages.clear();
  ASSERT_TRUE(sendGround(run));
  const auto found = [&] {
    for (const AlignmentEstimate& e : coarse_.messages)
      if (e.status == AlignmentEstimate::STATUS_CONVERGED) return &e;
    return static_cast<const AlignmentEstimate*>(nullptr);
  };
  // Eight of them, with rests of four times what each takes.
  ASSERT_TRUE(spinUntil([&] { return found() != nullptr; }, 4 * ros_utils::patience()));
  EXPECT_LE(found()->header.stamp, left);
  expectSane(*found());
  const auto error = syn::errorOf(ros_utils::fromMsg(found()->pose.pose), run.T_ground_mav[7], run.aerial[7].reference);
  EXPECT_LT(error.position, 0.3);
}

// A loop of the ground robot's map is closed, while the MAV stands: the map has hardly more cells than before.
TEST_F(NodeTest, ACorrectedGroundMapIsSearchedAgain) {
  const auto run = world(501, 4);
  sendGroundStatus(1, 1);
  auto before = run;
  before.ground = syn::drifted(run.ground);
  ASSERT_TRUE(sendGround(before));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  ASSERT_NE(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  clear();
  sendGroundStatus(1, 2);
  // What was on its way is of the map as it was.
  ASSERT_TRUE(diagnostics_.await("corrections of the map of the ground robot", 1));
  const int dropped = diagnostics_.counted("ground clouds of an earlier map dropped");
  stamp_ -= ros::Duration(1);
  ground_.publish(cloudMsg(before.ground, "ground_map", stamp_));
  ASSERT_TRUE(diagnostics_.await("ground clouds of an earlier map dropped", dropped + 1));
  stamp_ += ros::Duration(2);
  ASSERT_TRUE(sendGround(run));
  ASSERT_TRUE(spinUntil([&] { return !coarse_.messages.empty(); }));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
}

TEST_F(NodeTest, InitialPoseIsUsed) {
  const auto run = world(605, 2, syn::World::kIdenticalBoxes);
  ASSERT_TRUE(sendGround(run));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  // Odometry here has no heading: base_link is turned like mav_map.
  const Pose truth = run.T_ground_mav[1];
  const auto guess =
      guessAt(air_ground_common::yawPose(air_ground_common::yawOf(truth.rotation()), truth * run.aerial[1].reference));
  const std::size_t before = coarse_.messages.size();
  guess_.publish(guess);
  // The ground map may come once more since the reset, and be answered before.
  const auto error = [&] { return syn::errorOf(ros_utils::fromMsg(last().pose.pose), truth, run.aerial[1].reference); };
  EXPECT_TRUE(spinUntil([&] {
    return coarse_.messages.size() > before && error().position < 0.3 && error().yaw < 0.15;
  })) << error().position
      << " m, " << error().yaw << " rad";
}

TEST_F(NodeTest, InitialPoseEndsWithTheMapThatItWasAbout) {
  const auto run = world(601, 8);
  ASSERT_TRUE(sendGround(run));
  sendStatus(1);
  ASSERT_TRUE(sendAerial(run.aerial[0]));
  // A heading that is wrong for the map that comes next.
  const Pose truth = run.T_ground_mav[0];
  const std::size_t before = coarse_.messages.size();
  guess_.publish(guessAt(
      air_ground_common::yawPose(air_ground_common::yawOf(truth.rotation()) + 2, truth * run.aerial[0].reference)));
  // The ground map's answer, if it came once more, would have the right heading.
  ASSERT_TRUE(spinUntil([&] {
    return coarse_.messages.size() > before &&
           (last().overlap == 0 ||
            syn::errorOf(ros_utils::fromMsg(last().pose.pose), truth, run.aerial[0].reference).yaw > 1);
  }));
  stamp_ += ros::Duration(1);
  sendStatus(2);
  ASSERT_TRUE(spinUntil([&] { return last().map_id == 2; }));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_CONVERGED) << last().reason;
  EXPECT_LT(
      syn::errorOf(ros_utils::fromMsg(last().pose.pose), run.T_ground_mav.back(), run.aerial.back().reference).position,
      0.2);
}

TEST_F(NodeTest, FlatFloorIsRefused) {
  const auto run = world(606, 4, syn::World::kFlatFloor);
  ASSERT_TRUE(sendGround(run));
  for (const auto& cloud : run.aerial) ASSERT_TRUE(sendAerial(cloud));
  for (const auto& e : coarse_.messages) EXPECT_NE(e.status, AlignmentEstimate::STATUS_CONVERGED);
  EXPECT_EQ(last().status, AlignmentEstimate::STATUS_DEGENERATE) << last().reason;
}

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "heightmap_mcl_node_test");
  ros::NodeHandle keep;
  return RUN_ALL_TESTS();
}
