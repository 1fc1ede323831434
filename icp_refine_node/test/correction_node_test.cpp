// The MAV's odometry corrects its map while the running node holds clouds of it.
#include <utility>

#include "node_fixture.h"

namespace icp_refine {
namespace {

class CorrectionTest : public NodeTest {
 protected:
  /// Until the pose is refined; `aerial`: the cloud as it was published.
  void align(const synthetic::Scene& scene, sensor_msgs::PointCloud2* aerial) {
    ASSERT_NO_FATAL_FAILURE(sendGround(scene.ground));
    *aerial = cloud(scene.aerial, "mav_map");
    aerial_.publish(*aerial);
    sendCoarse(offset(scene));
    ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  }

  void send(const air_ground_common::CloudCorrections& corrections) { sendCorrections(corrections, 0); }

  /// Of where the alignment puts the cloud's middle, which the correction has moved.
  double errorAfter(const Similarity& S, const synthetic::Scene& scene) const {
    const Eigen::Vector3d centre = synthetic::centroid(scene.aerial);
    const Similarity T = similarity(ros_utils::fromMsg(estimates_.back().pose.pose), estimates_.back().scale);
    return (T * (S * centre) - scene.truth * centre).norm();
  }

  /// Share of the augmented map's aerial points that lie on the scene's surface.
  double shareOnSurface(const synthetic::Scene& scene) const {
    const air_ground_common::MeshScene mesh(scene.mesh);
    double aerial = 0, near = 0;
    for (const auto& p : ros_utils::cloudFromMsg(maps_.back())) {
      aerial += p.source == 1;
      near += p.source == 1 &&
              mesh.distance((scene.T_world_ground_map * p.position.cast<double>()).cast<float>(), 1) < 0.08f;
    }
    return near / aerial;
  }
};

std::int64_t stampOf(const sensor_msgs::PointCloud2& cloud) {
  return static_cast<std::int64_t>(cloud.header.stamp.toNSec());
}

TEST_F(CorrectionTest, CloudsAndAlignmentFollow) {
  const auto scene = synthetic::makeScene(1);
  sensor_msgs::PointCloud2 aerial;
  ASSERT_NO_FATAL_FAILURE(align(scene, &aerial));
  ASSERT_TRUE(waitFor([this] { return anyAerialPoint(); }));

  // By more than ICP reaches.
  const Similarity S{1.005, Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {1, -0.5, 0.2}};
  estimates_.clear();
  maps_.clear();
  tick(1);
  send({{stampOf(aerial), S}});
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_LT(errorAfter(S, scene), 0.08);
  ASSERT_TRUE(waitFor([this] { return anyAerialPoint(); }));
  EXPECT_GT(shareOnSurface(scene), 0.9);

  // The correction may overtake its cloud; what came before says nothing new.
  tick(1);
  const auto late = cloud(scene.aerial, "mav_map");
  estimates_.clear();
  maps_.clear();
  send({{stampOf(aerial), S}, {stampOf(late), S}});
  ASSERT_TRUE(settle());
  aerial_.publish(late);
  ASSERT_TRUE(settle());
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_LT(errorAfter(S, scene), 0.08);

  // Where the map has bent the clouds go, the pose stays.
  maps_.clear();
  tick(1);
  send({{stampOf(aerial), std::nullopt}, {stampOf(late), std::nullopt}});
  ASSERT_TRUE(waitFor([this] { return lastReason().find("aerial") != std::string::npos; })) << lastReason();
  ASSERT_TRUE(waitFor([this] { return !maps_.empty() && aerialPoints(maps_.back()) == 0; }));
}

TEST_F(CorrectionTest, ACorrectedGroundMapIsFollowedByAMavThatHasLanded) {
  const auto scene = synthetic::makeScene(1);
  sendGroundStatus(1, 0);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  const Eigen::Vector3d centre = scene.truth * synthetic::centroid(scene.aerial);
  const Pose correction = Eigen::Translation3d(centre + Eigen::Vector3d(0.4, 0.3, 0)) *
                          Eigen::AngleAxisd(0.04, Eigen::Vector3d::UnitZ()) * Eigen::Translation3d(-centre);
  estimates_.clear();
  tick(1);
  sendGroundStatus(1, 1);
  ground_.publish(cloud(transformed(scene.ground, correction), "ground_map"));
  auto moved = scene;
  moved.truth = Similarity{scene.truth.scale, correction.linear() * scene.truth.R, correction * scene.truth.t};
  // No other cloud of the MAV comes.
  EXPECT_TRUE(waitFor([&] { return !estimates_.empty() && error(estimates_.back(), moved) < 0.08; }, 1500))
      << lastReason();
}

// The corrected map overtakes the news of it. Once the pose has converged on it, a leap is one again.
TEST_F(CorrectionTest, ACorrectedGroundMapMayComeBeforeItIsSaid) {
  const auto scene = synthetic::makeScene(1);
  sendGroundStatus(1, 0);
  sendScene(scene);
  sendCoarse(offset(scene));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  tick(1);
  const auto corrected = cloud(scene.ground, "ground_map");
  ground_.publish(corrected);
  ASSERT_TRUE(waitFor([&] { return isTaken(ground_); }));
  estimates_.clear();
  const double now = std::exchange(now_, corrected.header.stamp.toSec());
  sendGroundStatus(1, 1);
  now_ = now;
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  tick(1);
  const auto elsewhere = cloud(transformed(scene.ground, Pose(Eigen::Translation3d(0.2, 0, 0))), "ground_map");
  ground_.publish(elsewhere);
  ASSERT_TRUE(waitFor([&] { return isTaken(ground_); }));
  tick(1);
  const ros::Time newest(now_);
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  ASSERT_TRUE(waitFor([&] { return estimates_.back().header.stamp == newest; }));
  EXPECT_EQ(estimates_.back().status, AlignmentEstimate::STATUS_SEARCHING);
  EXPECT_NE(lastReason().find("far from the last pose"), std::string::npos) << lastReason();
}

// The coarse stage found them while it searched what the MAV had left behind; of newer ones it knows nothing better.
TEST_F(CorrectionTest, AmbiguousNewerCloudsTakeBackNothingOfThoseThatWereLeftBehind) {
  const auto scene = synthetic::makeScene(1);
  const auto sendCoarseOf = [&](double stamp, std::uint8_t status) {
    const double now = std::exchange(now_, stamp);
    sendCoarse(offset(scene), status);
    now_ = now;
  };
  const double begin = now_;
  tick(25);
  Cloud few;
  few.points.assign(scene.ground.points.begin(), scene.ground.points.begin() + 50);
  ASSERT_NO_FATAL_FAILURE(sendGround(few));
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  sendCoarseOf(begin + 20, AlignmentEstimate::STATUS_SEARCHING);
  sendCoarseOf(begin + 5, AlignmentEstimate::STATUS_CONVERGED);
  sendCoarseOf(begin + 21, AlignmentEstimate::STATUS_AMBIGUOUS);
  ASSERT_TRUE(settle());
  EXPECT_NE(lastReason().find("ground points"), std::string::npos) << lastReason();
  tick(1);
  ground_.publish(cloud(scene.ground, "ground_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

TEST_F(CorrectionTest, WhatCannotBeIsCountedAndChangesNothing) {
  const auto scene = synthetic::makeScene(1);
  sensor_msgs::PointCloud2 aerial;
  ASSERT_NO_FATAL_FAILURE(align(scene, &aerial));
  air_ground::CloudCorrections msg;
  msg.header.stamp = ros::Time(now_);
  msg.header.frame_id = "mav_map";
  msg.stamps = {aerial.header.stamp};
  msg.scales = {2};
  corrections_.publish(msg);  // no pose
  msg.poses.emplace_back().orientation.w = 1;
  msg.scales = {-1};
  corrections_.publish(msg);
  ASSERT_TRUE(awaitCount(
      "corrections of clouds unreadable: corrections of clouds: stamps, poses and scales differ in number", 1));
  ASSERT_TRUE(awaitCount(
      "corrections of clouds unreadable: corrections of clouds: a scale is neither 0 nor between 0.1 and 10", 1));
  estimates_.clear();
  ASSERT_TRUE(settle());
  EXPECT_LT(error(estimates_.back(), scene), 0.08);
}

}  // namespace
}  // namespace icp_refine
