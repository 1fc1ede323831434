// What the running node says to those who fly by the alignment: that it holds, that it has ended, and where the MAV is.
#include "node_fixture.h"

namespace icp_refine {
namespace {

class OutputTest : public NodeTest {
 protected:
  void align(const synthetic::Scene& scene) {
    sendGroundStatus(3);
    sendStatus(7);
    ASSERT_TRUE(settle());
    sendScene(scene);
    sendCoarse(offset(scene), AlignmentEstimate::STATUS_CONVERGED, 7);
    ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
    converged_ = estimates_.back();
  }

  /// Clouds as of another place, until those that were aligned are forgotten (recent_clouds are 6).
  void flyOff(const synthetic::Scene& scene) {
    const Cloud far = transformed(scene.aerial, Pose(Eigen::Translation3d(40, 0, 0)));
    for (int k = 0; k < 6; ++k) {
      tick(0.5);
      const auto msg = cloud(far, "mav_map");
      far_.push_back(static_cast<std::int64_t>(msg.header.stamp.toNSec()));
      aerial_.publish(msg);
      ASSERT_TRUE(waitFor([&] { return estimates_.back().header.stamp == msg.header.stamp; })) << lastReason();
      if (estimates_.back().status == AlignmentEstimate::STATUS_CONVERGED) converged_ = estimates_.back();
    }
    ASSERT_NE(estimates_.back().status, AlignmentEstimate::STATUS_CONVERGED);
  }

  void expectHeld() {
    EXPECT_NE(estimates_.back().status, AlignmentEstimate::STATUS_CONVERGED);
    EXPECT_TRUE(estimates_.back().held) << lastReason();
    EXPECT_EQ(estimates_.back().converged_stamp, converged_.header.stamp);
    transforms_.clear();
    EXPECT_TRUE(waitFor([this] { return transforms_.size() >= 3; }));
  }

  /// Until the node has refined with the clouds as they lie now, which leaves the pose held.
  void correct(const air_ground_common::CloudCorrections& corrections) {
    estimates_.clear();
    sendCorrections(corrections, 7);
    ASSERT_TRUE(waitFor([this] { return !estimates_.empty(); }));
    expectHeld();
  }

  AlignmentEstimate converged_;
  std::vector<std::int64_t> far_;  // stamps of the clouds of another place
};

TEST_F(OutputTest, APoseThatIsKeptIsHeldUntilItIsLost) {
  const auto scene = synthetic::makeScene(1), other = synthetic::makeScene(17);
  ASSERT_NO_FATAL_FAILURE(align(scene));
  EXPECT_FALSE(converged_.held);
  EXPECT_EQ(converged_.converged_stamp, converged_.header.stamp);
  EXPECT_EQ(converged_.map_id, 7u);
  EXPECT_EQ(converged_.ground_map_id, 3u);
  ASSERT_NO_FATAL_FAILURE(flyOff(scene));
  expectHeld();
  poses_.clear();
  sendOdometry(Pose::Identity());
  EXPECT_TRUE(waitFor([this] { return !poses_.empty(); }));

  const auto wrong = transformed(
      other.aerial, scene.T_ground_map_mav_map.inverse() * scene.T_world_ground_map.inverse() * other.T_world_mav_map);
  for (int k = 0; k < 30 && lastReason().find("lost after") == std::string::npos; ++k) {
    const std::size_t before = estimates_.size();
    aerial_.publish(cloud(wrong, "mav_map"));
    ASSERT_TRUE(waitFor([&] { return estimates_.size() > before; }));
  }
  ASSERT_NE(lastReason().find("lost after"), std::string::npos) << lastReason();
  EXPECT_FALSE(estimates_.back().held);
  EXPECT_TRUE(estimates_.back().converged_stamp.isZero());
  EXPECT_TRUE(noTransformAfter(now_));
}

// Some fill what they do not know with NaN. Then nobody gets a pose, but tf is right where the MAV is.
TEST_F(OutputTest, OdometryWithoutCovarianceStillSaysWhereTheMavIs) {
  const auto scene = synthetic::makeScene(1);
  ASSERT_NO_FATAL_FAILURE(align(scene));
  poses_.clear();
  sendOdometry(Pose::Identity(), std::nan(""));
  EXPECT_TRUE(awaitCount("odometry whose covariance is not finite", 1));
  EXPECT_TRUE(poses_.empty());
  sendOdometry(Pose::Identity());
  EXPECT_TRUE(waitFor([this] { return !poses_.empty(); }));
}

TEST_F(OutputTest, WhatIsHeldFollowsCorrectionsOfTheMavsMap) {
  const auto scene = synthetic::makeScene(1);
  ASSERT_NO_FATAL_FAILURE(align(scene));
  ASSERT_NO_FATAL_FAILURE(flyOff(scene));
  expectHeld();
  const Eigen::Vector3d centre(converged_.reference_point.x, converged_.reference_point.y,
                               converged_.reference_point.z);
  const Eigen::Vector3d p = lastTransform().inverse() * centre;
  const Similarity S{1, Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {1, -0.5, 0.2}};
  air_ground_common::CloudCorrections corrections;
  for (const std::int64_t stamp : far_) corrections[stamp] = S;
  ASSERT_NO_FATAL_FAILURE(correct(corrections));
  EXPECT_LT((lastTransform() * (S * p) - centre).norm(), 1e-6);
}

TEST_F(OutputTest, TheAlignmentOfOldCloudsMovesNothingWhenTheMapIsCorrectedElsewhere) {
  const auto scene = synthetic::makeScene(1);
  ASSERT_NO_FATAL_FAILURE(align(scene));
  ASSERT_NO_FATAL_FAILURE(flyOff(scene));
  expectHeld();
  const Pose before = lastTransform();
  // The newest cloud of the last CONVERGED reading, and those before, stay where they are.
  const auto aligned = static_cast<std::int64_t>(converged_.header.stamp.toNSec());
  ASSERT_LT(aligned, far_.back());
  air_ground_common::CloudCorrections corrections{{aligned, Similarity()}};
  for (const std::int64_t stamp : far_)
    if (stamp > aligned) corrections[stamp] = Similarity{1, Eigen::Matrix3d::Identity(), {0.8, 0.3, 0}};
  ASSERT_NO_FATAL_FAILURE(correct(corrections));
  EXPECT_LT((lastTransform().translation() - before.translation()).norm(), 1e-6);
}

// heightmap_mcl was started again, and dense_fusion sends it the clouds that it kept, the oldest first.
TEST_F(OutputTest, CoarsePosesOfOldCloudsAreNoJumpOfTime) {
  const auto scene = synthetic::makeScene(1);
  ASSERT_NO_FATAL_FAILURE(align(scene));
  for (int k = 0; k < 12; ++k) {
    tick(0.5);
    sendCoarse(offset(scene), AlignmentEstimate::STATUS_CONVERGED, 7);
    ASSERT_TRUE(settle());
  }
  ASSERT_TRUE(waitFor([this] { return anyAerialPoint(); }));
  maps_.clear();
  estimates_.clear();
  AlignmentEstimate old = converged_;
  old.header.stamp = ros::Time(now_ - 60);
  old.ground_map_id = 0;
  coarse_.publish(old);
  ASSERT_TRUE(settle());
  for (const AlignmentEstimate& e : estimates_) EXPECT_NE(e.status, AlignmentEstimate::STATUS_SEARCHING) << e.reason;
  transforms_.clear();
  EXPECT_TRUE(waitFor([this] { return transforms_.size() >= 3; })) << "tf goes on";
  for (const auto& map : maps_) EXPECT_GT(aerialPoints(map), 0u);
}

TEST_F(OutputTest, CoarsePosesInAnotherGroundMapAreNotTaken) {
  const auto scene = synthetic::makeScene(1);
  sendGroundStatus(3);
  sendStatus(7);
  ASSERT_TRUE(settle());
  sendScene(scene);
  AlignmentEstimate coarse;
  coarse.header.stamp = ros::Time(now_);
  coarse.header.frame_id = "ground_map";
  coarse.child_frame_id = "mav_map";
  coarse.pose.pose = ros_utils::toMsg(offset(scene));
  coarse.status = AlignmentEstimate::STATUS_CONVERGED;
  coarse.map_id = 7;
  coarse.ground_map_id = 2;
  coarse_.publish(coarse);
  ASSERT_TRUE(awaitCount("coarse alignments of another ground map", 1));
  ASSERT_TRUE(settle());
  EXPECT_EQ(lastReason(), "waiting for a coarse alignment or a manual guess");
  coarse.ground_map_id = 3;
  coarse_.publish(coarse);
  EXPECT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

TEST_F(OutputTest, WhoComesLaterHearsTheLastWord) {
  ASSERT_TRUE(settle());
  AlignmentEstimate last;
  const ros::Subscriber late = handle_.subscribe<AlignmentEstimate>(
      "alignment/refined", 10, [&](const AlignmentEstimate::ConstPtr& msg) { last = *msg; });
  ASSERT_TRUE(waitFor([&] { return !last.header.frame_id.empty(); }));
  EXPECT_EQ(last.header.stamp, estimates_.back().header.stamp);
  EXPECT_EQ(last.reason, lastReason());
}

/// Plainly: the pose of the base, and its change by what is uncertain, one after the other.
class PoseReference {
 public:
  PoseReference(const AlignmentEstimate& e, const nav_msgs::Odometry& odometry)
      : T_(similarity(ros_utils::fromMsg(e.pose.pose), e.scale)),
        centre_(e.reference_point.x, e.reference_point.y, e.reference_point.z),
        T_mav_map_base_(ros_utils::fromMsg(odometry.pose.pose)) {
    C_.topLeftCorner<6, 6>() = ros_utils::covarianceFromMsg(e.pose.covariance);
    C_(6, 6) = e.scale_stddev * e.scale_stddev / (e.scale * e.scale);
    C_.bottomRightCorner<6, 6>() = ros_utils::covarianceFromMsg(odometry.pose.covariance);
  }

  Matrix6d covariance() const {
    constexpr double kStep = 1e-6;
    const Pose T = poseAfter(Vector13d::Zero());
    Eigen::Matrix<double, 6, 13> J;
    for (int i = 0; i < 13; ++i) {
      const Pose moved = poseAfter(kStep * Vector13d::Unit(i));
      J.col(i) << (moved.translation() - T.translation()) / kStep,
          air_ground_common::logSO3(moved.linear() * T.linear().transpose()) / kStep;
    }
    return J * C_ * J.transpose();
  }

 private:
  using Vector13d = Eigen::Matrix<double, 13, 1>;

  Pose poseAfter(const Vector13d& x) const {
    using air_ground_common::expSO3;
    const Eigen::Matrix3d turn = expSO3(x.segment<3>(3));
    const Eigen::Vector3d p = T_mav_map_base_.translation() + x.segment<3>(7);
    Pose out = Pose::Identity();
    out.translation() = centre_ + std::exp(x[6]) * (turn * (T_ * p - centre_)) + x.head<3>();
    out.linear() = turn * T_.R * expSO3(x.tail<3>()) * T_mav_map_base_.linear();
    return out;
  }

  const Similarity T_;
  const Eigen::Vector3d centre_;
  const Pose T_mav_map_base_;
  Eigen::Matrix<double, 13, 13> C_ = Eigen::Matrix<double, 13, 13>::Zero();
};

TEST_F(OutputTest, ThePoseInTheGroundMapIsThatOfTf) {
  const auto scene = synthetic::makeScene(1);
  nav_msgs::Odometry odometry;
  odometry.header.frame_id = "mav_map";
  Eigen::Matrix<double, 6, 6> A = Matrix6d::Identity();
  for (int i = 0; i < 36; ++i) A(i) += 0.3 * std::sin(i);
  ros_utils::setCovariance(1e-4 * A * A.transpose(), &odometry.pose.covariance);
  const auto send = [&](const Pose& T) {
    odometry.header.stamp = ros::Time(now_);
    odometry.pose.pose = ros_utils::toMsg(T);
    odometry_.publish(odometry);
  };
  send(Pose::Identity());
  ASSERT_TRUE(settle());
  ASSERT_NO_FATAL_FAILURE(align(scene));
  ASSERT_TRUE(settle());
  EXPECT_TRUE(poses_.empty()) << "before there was an alignment";

  const auto& reference = converged_.reference_point;
  const Eigen::Vector3d overlap =
      scene.T_ground_map_mav_map.inverse() * Eigen::Vector3d(reference.x, reference.y, reference.z);
  double before = 0;
  for (const double distance : {0., 5., 20.}) {
    const Pose T_mav_map_base = air_ground_common::yawPose(0.8, overlap + Eigen::Vector3d(distance, 0, 1.5)) *
                                Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitX());
    poses_.clear();
    send(T_mav_map_base);
    ASSERT_TRUE(waitFor([&] { return !poses_.empty(); }));
    ASSERT_TRUE(settle());
    transforms_.clear();
    ASSERT_TRUE(waitFor([this] { return transforms_.size() >= 3; }));
    poses_.clear();
    tick();
    send(T_mav_map_base);  // by the alignment of now
    ASSERT_TRUE(waitFor([&] { return !poses_.empty(); }));
    const auto& msg = poses_.back();
    EXPECT_EQ(msg.header.frame_id, "ground_map");
    EXPECT_EQ(msg.header.stamp, odometry.header.stamp);
    const Pose T = ros_utils::fromMsg(msg.pose.pose), of_tf = lastTransform() * T_mav_map_base;
    EXPECT_LT((T.translation() - of_tf.translation()).norm(), 1e-6);
    EXPECT_LT(air_ground_common::rotationAngle(T.linear(), of_tf.linear()), 1e-6);
    const Matrix6d C = ros_utils::covarianceFromMsg(msg.pose.covariance);
    const Matrix6d expected = PoseReference(estimates_.back(), odometry).covariance();
    EXPECT_LT((C - expected).norm(), 1e-4 * expected.norm()) << C << "\nexpected\n" << expected;
    const double variance = C.diagonal().head<3>().sum();
    EXPECT_GT(variance, before) << "farther from the overlap";
    before = variance;
  }

  tick(1);
  sendStatus(8);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_SEARCHING)) << lastReason();
  poses_.clear();
  tick();
  send(Pose::Identity());
  ASSERT_TRUE(settle());
  EXPECT_TRUE(poses_.empty()) << "after the map has ended";
}

}  // namespace
}  // namespace icp_refine
