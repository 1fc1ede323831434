// The running node on synthetic clouds: topics, tf, statuses, and what it does with bad input. Run from
// icp_refine_node.test. The test owns /clock: outputs of an earlier test, or of before an event, are told by their
// stamps.
#include "node_fixture.h"

namespace icp_refine {
namespace {

TEST_F(NodeTest, RefinesPublishesTfAndTheMap) {
  const auto scene = synthetic::makeScene(1);
  sendScene(scene);
  // With both clouds there it asks for a coarse pose.
  ASSERT_TRUE(waitFor([&] { return lastReason().find("coarse") != std::string::npos; })) << lastReason();
  EXPECT_EQ(estimates_.back().status, AlignmentEstimate::STATUS_SEARCHING);
  sendCoarse(offset(scene), AlignmentEstimate::STATUS_AMBIGUOUS);
  ASSERT_TRUE(settle());
  pause(25);
  EXPECT_TRUE(transforms_.empty());
  EXPECT_FALSE(anyAerialPoint());
  maps_.clear();

  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  const auto estimate = estimates_.back();
  EXPECT_LT(error(estimate, scene), 0.08);
  EXPECT_EQ(estimate.header.frame_id, "ground_map");
  EXPECT_EQ(estimate.child_frame_id, "mav_map");
  EXPECT_EQ(estimate.stage, AlignmentEstimate::STAGE_REFINED);
  EXPECT_GT(estimate.overlap, 0.2);
  EXPECT_GT(estimate.cost, 0);
  const auto eigen = air_ground_common::symmetricEigen(ros_utils::covarianceFromMsg(estimate.pose.covariance));
  EXPECT_GT(eigen.values[0], 0);
  EXPECT_LT(eigen.values[5], 0.15 * 0.15);

  // tf: one edge, the right way round, strictly increasing stamps.
  ASSERT_TRUE(waitFor([this] { return transforms_.size() >= 8; }));
  ros::Time last;
  for (const auto& t : transforms_) {
    EXPECT_EQ(t.header.frame_id, "ground_map");
    EXPECT_EQ(t.child_frame_id, "mav_map");
    EXPECT_GT(t.header.stamp, last);
    last = t.header.stamp;
  }
  const Eigen::Vector3d centre = synthetic::centroid(scene.aerial);
  EXPECT_LT((lastTransform() * centre - scene.truth * centre).norm(), 0.08);

  // The map: both sources, aerial points on the scene's surface.
  ASSERT_TRUE(waitFor([this] { return !maps_.empty(); }));
  EXPECT_EQ(maps_.back().header.frame_id, "ground_map");
  const auto points = ros_utils::cloudFromMsg(maps_.back());
  const air_ground_common::MeshScene mesh(scene.mesh);
  std::size_t aerial = 0, near = 0;
  for (const auto& p : points) {
    if (p.source == 0) {
      EXPECT_GT(p.rgb[0], p.rgb[1] + 100);
      continue;
    }
    EXPECT_EQ(p.rgb[0], p.rgb[1]);
    ++aerial;
    near += mesh.distance((scene.T_world_ground_map * p.position.cast<double>()).cast<float>(), 1) < 0.08f;
  }
  EXPECT_GT(aerial, 5000u);
  EXPECT_LT(aerial, points.size());
  EXPECT_GT(near, 0.9 * aerial);

  for (const std::string extension : {".ply", ".pcd"}) {
    air_ground::SaveMap save;
    save.request.path = std::string(P_tmpdir) + "/icp_refine_node_test" + extension;
    ASSERT_TRUE(ros_utils::callService("/icp_refine/save_map", save));
    EXPECT_TRUE(save.response.success) << save.response.message;
    EXPECT_EQ(save.response.points, points.size());
    if (extension == ".ply") {
      std::set<int> sources;
      for (const auto& p : air_ground_common::readPlyPoints(save.request.path)) sources.insert(p.source);
      EXPECT_EQ(sources, (std::set<int>{0, 1}));
    }
    std::remove(save.request.path.c_str());
  }
  air_ground::SaveMap save;
  save.request.path = "/nonexistent/map.ply";
  ASSERT_TRUE(ros_utils::callService("/icp_refine/save_map", save));
  EXPECT_FALSE(save.response.success);

  // Tracking: the next cloud needs no coarse pose.
  estimates_.clear();
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED));
}

TEST_F(NodeTest, EstimatesTheScaleAndTfIsRightWhereTheMavIs) {
  synthetic::SceneSettings settings;
  settings.scale_error = settings.ground_drift = 0;
  settings.scale_offset = 0.03;
  settings.smooth_edges = false;
  const auto scene = synthetic::makeScene(31, settings);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  const auto estimate = estimates_.back();
  EXPECT_NEAR(estimate.scale, 1 / 1.03, 0.005);
  EXPECT_GT(estimate.scale_stddev, 0);
  EXPECT_LT(estimate.scale_stddev, 0.008);
  // Where the MAV is, tf agrees with the alignment; the rest of mav_map it cannot hold: 3 % of the way.
  for (const Eigen::Vector3d& p : {Eigen::Vector3d(4, -3, 2), Eigen::Vector3d(-5, 1, 1.5)}) {
    sendOdometry(Pose(Eigen::Translation3d(p)));
    ASSERT_TRUE(settle());
    transforms_.clear();
    ASSERT_TRUE(waitFor([this] { return transforms_.size() >= 3; }));
    const Similarity T = similarity(ros_utils::fromMsg(estimates_.back().pose.pose), estimates_.back().scale);
    EXPECT_LT((lastTransform() * p - T * p).norm(), 1e-6);
    EXPECT_LT((lastTransform() * p - scene.truth * p).norm(), 0.06);
  }
}

TEST_F(NodeTest, AResetKeepsTheLatchedGroundMapWithoutTheMaster) {
  const auto scene = synthetic::makeScene(1);
  sendScene(scene);
  ASSERT_TRUE(settle());
  const int connections = ground_connections_;
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("/icp_refine/reset", reset));
  ASSERT_TRUE(settle());
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_EQ(ground_connections_, connections) << "it subscribed again, which asks the master";
}

TEST_F(NodeTest, ABusyWorkerDropsTheOldestClouds) {
  const auto scene = synthetic::makeScene(1);
  sendScene(scene);
  const int dropped = countedNow("dense clouds dropped: refinement does not keep up");
  sendCoarse(offset(scene));
  for (int k = 0; k < 40; ++k) {  // queue_size is 4 in this test
    now_ += 1e-3;
    aerial_.publish(cloud(scene.aerial, "mav_map"));
    ros::WallDuration(0.005).sleep();
  }
  ASSERT_TRUE(awaitCount("dense clouds dropped: refinement does not keep up", dropped + 1));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

TEST_F(NodeTest, FlatFloorIsRefused) {
  synthetic::SceneSettings settings;
  settings.world = synthetic::World::kFlat;
  const auto scene = synthetic::makeScene(2, settings);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_DEGENERATE)) << lastReason();
  EXPECT_NE(estimates_.back().reason.find("about z"), std::string::npos) << lastReason();
  EXPECT_GT(estimates_.back().pose.covariance[0], 0.25);
  pause(50);
  EXPECT_TRUE(transforms_.empty());
  EXPECT_FALSE(anyAerialPoint());
}

TEST_F(NodeTest, AWrongBasinIsRejected) {
  const auto scene = synthetic::makeScene(1);
  sendScene(scene);
  const Eigen::Vector3d m = scene.T_ground_map_mav_map * synthetic::centroid(scene.aerial);
  Pose turn = Pose::Identity();
  turn.linear() = Eigen::AngleAxisd(2.0, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  turn.translation() = m + Eigen::Vector3d(0.5, 0.3, 0) - turn.linear() * m;
  sendCoarse(turn * scene.T_ground_map_mav_map);
  ASSERT_TRUE(waitFor(
      [this] { return !estimates_.empty() && estimates_.back().status != AlignmentEstimate::STATUS_SEARCHING; }));
  EXPECT_NE(estimates_.back().status, AlignmentEstimate::STATUS_CONVERGED) << lastReason();
  EXPECT_FALSE(estimates_.back().reason.empty());
  pause(25);
  EXPECT_TRUE(transforms_.empty());
}

TEST_F(NodeTest, BadInputIsCountedNotFatal) {
  const auto scene = synthetic::makeScene(1);
  auto broken = scene;
  for (auto& p : broken.aerial.points) p.x() = std::nanf("");
  aerial_.publish(cloud(scene.aerial, "ground_map"));  // wrong frame
  aerial_.publish(cloud(broken.aerial, "mav_map"));    // all NaN
  aerial_.publish(cloud(Cloud{}, "mav_map"));          // empty
  aerial_.publish(sensor_msgs::PointCloud2());         // no frame, no fields
  ground_.publish(cloud(Cloud{}, "ground_map"));
  Cloud few;
  few.points.assign(5, Eigen::Vector3f(1, 2, 3));
  ground_.publish(cloud(few, "ground_map"));  // too few, all in one place
  aerial_.publish(cloud(few, "mav_map"));
  Pose nan = Pose::Identity();
  nan.translation().x() = std::nan("");
  sendCoarse(nan);
  auto zero = geometry_msgs::PoseWithCovarianceStamped();
  zero.header.frame_id = "ground_map";
  guess_.publish(zero);  // quaternion 0 0 0 0
  sendCoarse(Pose::Identity());
  for (const char* event :
       {"dense clouds without a finite point", "dense clouds in frame 'ground_map'", "dense clouds in frame ''",
        "ground maps without a finite point", "coarse alignments unreadable", "initial pose unreadable",
        "points of dense clouds that are not finite"}) {
    EXPECT_TRUE(awaitCount(event, 1)) << event;
  }
  ASSERT_TRUE(settle());
  for (const auto& e : estimates_) {
    EXPECT_NE(e.status, AlignmentEstimate::STATUS_CONVERGED);
    for (double c : e.pose.covariance) EXPECT_TRUE(std::isfinite(c));
    EXPECT_TRUE(std::isfinite(e.pose.pose.position.x) && std::isfinite(e.pose.pose.orientation.w));
  }
  // Still alive, and some NaN points do no harm.
  for (std::size_t i = 0; i < broken.aerial.size(); ++i) {
    if (i % 5) broken.aerial.points[i] = scene.aerial.points[i];
  }
  sendScene(broken);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_LT(error(estimates_.back(), scene), 0.08);
}

TEST_F(NodeTest, ManualGuessNeedsNoCoarsePose) {
  const auto scene = synthetic::makeScene(3);
  sendScene(scene);
  geometry_msgs::PoseWithCovarianceStamped guess;
  guess.header.frame_id = "ground_map";
  // The guess is a pose of the MAV's base, which is far from the origin of its map and turned.
  const Pose T_mav_map_base = air_ground_common::yawPose(1.1, {3, -2, 1.5});
  Pose T = offset(scene) * T_mav_map_base;
  T.translation().z() -= 0.7;  // drawn on the plane: the height is unknown
  guess.pose.pose = ros_utils::toMsg(T);
  const int before = countedNow("initial poses without odometry");
  guess_.publish(guess);
  ASSERT_TRUE(awaitCount("initial poses without odometry", before + 1));
  sendOdometry(T_mav_map_base);
  ASSERT_TRUE(settle());
  guess_.publish(guess);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_LT(error(estimates_.back(), scene), 0.08);
}

TEST_F(NodeTest, AnotherMapStartsAfresh) {
  const auto scene = synthetic::makeScene(1);
  sendStatus(7);
  sendScene(scene);
  sendCoarse(offset(scene), AlignmentEstimate::STATUS_CONVERGED, 7);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_EQ(estimates_.back().map_id, 7u);
  ASSERT_TRUE(refresh());
  const int maps = diagnostics_.counted("new maps of the MAV"),
            others = diagnostics_.counted("coarse alignments of another map");
  sendStatus(8);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_SEARCHING)) << lastReason();
  EXPECT_EQ(estimates_.back().map_id, 8u);
  EXPECT_EQ(lastReason(), "the MAV began another map");
  ASSERT_TRUE(refresh());
  EXPECT_NE(diagnostics_.level(), 0) << diagnostics_.message();
  ASSERT_TRUE(awaitCount("new maps of the MAV", maps + 1));
  EXPECT_TRUE(noTransformAfter(now_));
  sendCoarse(offset(scene), AlignmentEstimate::STATUS_CONVERGED, 7);  // about the old map
  ASSERT_TRUE(awaitCount("coarse alignments of another map", others + 1));
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  ASSERT_TRUE(waitFor([this] { return lastReason().find("coarse") != std::string::npos; })) << lastReason();
  sendCoarse(offset(scene), AlignmentEstimate::STATUS_CONVERGED, 8);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_EQ(estimates_.back().map_id, 8u);
}

TEST_F(NodeTest, ACorrectedMapOfTheMavDropsItsCloudsNotThePose) {
  const auto scene = synthetic::makeScene(1);
  sendStatus(7);
  sendScene(scene);
  sendCoarse(offset(scene), AlignmentEstimate::STATUS_CONVERGED, 7);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  ASSERT_TRUE(waitFor([this] { return anyAerialPoint(); }));
  ASSERT_TRUE(refresh());
  const int corrections = diagnostics_.counted("corrections of the map of the MAV"),
            earlier = diagnostics_.counted("dense clouds of an earlier map dropped");
  auto late = cloud(scene.aerial, "mav_map");
  tick(1);
  sendStatus(7, 1);
  ASSERT_TRUE(awaitCount("corrections of the map of the MAV", corrections + 1));
  ASSERT_TRUE(waitFor([this] { return aerialPoints(maps_.back()) == 0; })) << "points of the map as it was";
  aerial_.publish(late);
  ASSERT_TRUE(awaitCount("dense clouds of an earlier map dropped", earlier + 1));
  transforms_.clear();
  ASSERT_TRUE(waitFor([this] { return !transforms_.empty(); })) << "what relates the maps stays";
  estimates_.clear();
  tick(1);
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

TEST_F(NodeTest, AnotherGroundMapStartsAfresh) {
  const auto scene = synthetic::makeScene(1);
  sendGroundStatus(1);
  ASSERT_TRUE(settle());
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  ASSERT_TRUE(waitFor([this] { return !transforms_.empty() && anyAerialPoint(); }));
  const int earlier = countedNow("ground maps of an earlier map");
  EXPECT_EQ(estimates_.back().ground_map_id, 1u);
  sendGroundStatus(2);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_SEARCHING)) << lastReason();
  EXPECT_EQ(estimates_.back().ground_map_id, 2u);
  EXPECT_EQ(lastReason(), "the ground robot began another map");
  ASSERT_TRUE(refresh());
  EXPECT_NE(diagnostics_.level(), 0) << diagnostics_.message();
  // Nothing of the old map stays: no tf, no augmented map. It does not come back though it is latched still.
  ASSERT_TRUE(waitFor([this] { return !maps_.empty() && maps_.back().width * maps_.back().height == 0; }));
  EXPECT_TRUE(noTransformAfter(now_));
  ASSERT_TRUE(awaitCount("ground maps of an earlier map", earlier + 1));
  EXPECT_EQ(maps_.back().width * maps_.back().height, 0u);
  estimates_.clear();
  ASSERT_NO_FATAL_FAILURE(sendGround(scene.ground));
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

TEST_F(NodeTest, ACorrectedGroundMapIsFollowedWithinOneCloud) {
  const auto scene = synthetic::makeScene(1);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  // The ground robot closes a loop: its map, still the same one, moves by half a metre where the MAV is.
  const Eigen::Vector3d centre = scene.truth * synthetic::centroid(scene.aerial);
  std::uint32_t revision = 0;
  sendGroundStatus(1, revision);
  const std::string corrections = "corrections of the map of the ground robot";
  const int before = countedNow(corrections);
  for (const double direction : {0.6, 3.7}) {
    const Eigen::Vector3d step(0.5 * std::cos(direction), 0.5 * std::sin(direction), 0);
    const Pose correction = Eigen::Translation3d(centre + step) * Eigen::AngleAxisd(0.04, Eigen::Vector3d::UnitZ()) *
                            Eigen::Translation3d(-centre);
    tick(1);
    sendGroundStatus(1, ++revision);
    ASSERT_TRUE(awaitCount(corrections, before + static_cast<int>(revision)));
    auto corrected = cloud(transformed(scene.ground, correction), "ground_map");
    ground_.publish(corrected);
    ASSERT_TRUE(waitFor([&] { return isTaken(ground_); }));
    estimates_.clear();
    maps_.clear();
    tick(1);
    const ros::Time newest(now_);
    aerial_.publish(cloud(scene.aerial, "mav_map"));
    ASSERT_TRUE(waitFor([&] { return !estimates_.empty() && estimates_.back().header.stamp == newest; }));
    EXPECT_EQ(estimates_.back().status, AlignmentEstimate::STATUS_CONVERGED) << lastReason();
    auto moved = scene;
    moved.truth = Similarity{scene.truth.scale, correction.linear() * scene.truth.R, correction * scene.truth.t};
    EXPECT_LT(error(estimates_.back(), moved), 0.08) << lastReason();
    ASSERT_TRUE(waitFor([&] { return !maps_.empty() && maps_.back().header.stamp >= newest; }));
    const air_ground_common::MeshScene mesh(scene.mesh);
    std::size_t aerial = 0, near = 0;
    for (const auto& p : ros_utils::cloudFromMsg(maps_.back())) {
      if (p.source == 0) continue;
      ++aerial;
      const Eigen::Vector3d p_world = scene.T_world_ground_map * correction.inverse() * p.position.cast<double>();
      near += mesh.distance(p_world.cast<float>(), 1) < 0.08f;
    }
    EXPECT_GT(aerial, 2000u);
    EXPECT_GT(near, 0.9 * aerial);
  }
}

TEST_F(NodeTest, ACloudThatComesTwiceIsOne) {
  const auto scene = synthetic::makeScene(1);
  const int before = countedNow("dense clouds repeated");
  const auto once = cloud(scene.aerial, "mav_map");
  aerial_.publish(once);
  aerial_.publish(once);
  ASSERT_TRUE(awaitCount("dense clouds repeated", before + 1));
  // Whoever subscribes again gets what came before once more: no jump of time.
  tick(5);
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  aerial_.publish(once);
  ASSERT_TRUE(awaitCount("dense clouds repeated", before + 2));
}

TEST_F(NodeTest, ALostPoseLeavesTheAugmentedMap) {
  const auto scene = synthetic::makeScene(1), other = synthetic::makeScene(17);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  ASSERT_TRUE(waitFor([this] { return anyAerialPoint(); }));
  // Another scene at the same place contradicts, until the pose is given up.
  const auto wrong = transformed(
      other.aerial, scene.T_ground_map_mav_map.inverse() * scene.T_world_ground_map.inverse() * other.T_world_mav_map);
  for (int k = 0; k < 30 && (estimates_.empty() || estimates_.back().reason.find("lost after") == std::string::npos);
       ++k) {
    const std::size_t before = estimates_.size();
    aerial_.publish(cloud(wrong, "mav_map"));
    ASSERT_TRUE(waitFor([&] { return estimates_.size() > before; }));
  }
  ASSERT_NE(estimates_.back().reason.find("lost after"), std::string::npos) << lastReason();
  ASSERT_TRUE(waitFor([this] { return !maps_.empty() && aerialPoints(maps_.back()) == 0; }));
  air_ground::SaveMap save;
  save.request.path = std::string(P_tmpdir) + "/icp_refine_node_test_lost.ply";
  ASSERT_TRUE(ros_utils::callService("/icp_refine/save_map", save));
  EXPECT_NE(save.response.message.find("no alignment"), std::string::npos) << save.response.message;
  std::remove(save.request.path.c_str());
}

TEST_F(NodeTest, ALoopedBagResets) {
  const auto scene = synthetic::makeScene(1);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  ASSERT_TRUE(waitFor([this] { return anyAerialPoint(); }));
  const auto late = cloud(scene.aerial, "mav_map");
  sendStatus(0);
  ASSERT_TRUE(settle());
  ASSERT_TRUE(refresh());
  const int jumps = diagnostics_.counted("time jumps"),
            dropped = diagnostics_.counted("messages of the time before a jump dropped");
  now_ -= 500;
  pause(10);
  const ros::WallTime begin = ros::WallTime::now();
  maps_.clear();
  estimates_.clear();
  sendStatus(0);
  ASSERT_TRUE(waitFor([this] { return !maps_.empty() && aerialPoints(maps_.back()) == 0; }));
  const double jumped = now_;
  // A cloud that was still on its way enters nothing, and starts nothing afresh.
  aerial_.publish(late);
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  ASSERT_TRUE(waitFor([this] { return lastReason().find("coarse") != std::string::npos; })) << lastReason();
  const bool in_time =
      (ros::WallTime::now() - begin).toSec() < 3;  // after 3 s by the wall clock, nothing is late any more
  ASSERT_TRUE(refresh());
  if (in_time) {
    EXPECT_EQ(diagnostics_.counted("messages of the time before a jump dropped"), dropped + 1);
    EXPECT_EQ(diagnostics_.counted("time jumps"), jumps + 1);
  }
  EXPECT_TRUE(noTransformAfter(jumped));
  transforms_.clear();
  // And works again, with stamps of the second loop.
  const int all_jumps = diagnostics_.counted("time jumps");
  sendScene(scene);
  ASSERT_TRUE(awaitCount("time jumps", all_jumps + 1));  // the ground robot's
  ASSERT_TRUE(settle());
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  ASSERT_TRUE(waitFor([this] { return !transforms_.empty(); }));
}

}  // namespace
}  // namespace icp_refine

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "icp_refine_node_test");
  ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
