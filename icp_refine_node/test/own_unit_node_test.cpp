// The running node where clouds are in a unit of their own, and where it is told how high the ground camera stands.
#include <air_ground/MapKeyframes.h>
#include <sensor_msgs/CameraInfo.h>

#include "node_fixture.h"

namespace icp_refine {
namespace {

class OwnUnitTest : public NodeTest {
 protected:
  OwnUnitTest() {
    map_scale_ = handle_.advertise<AlignmentEstimate>("mav/map_scale", 5);
    views_ = handle_.advertise<AlignmentEstimate>("alignment/views", 5);
    info_ = handle_.advertise<sensor_msgs::CameraInfo>("ground/rgb/camera_info", 5);
    keyframes_ = handle_.advertise<air_ground::MapKeyframes>("ground/map_keyframes", 5);
    tf_static_ = handle_.advertise<tf2_msgs::TFMessage>("/tf_static", 5, true);
  }

  void SetUp() override {
    NodeTest::SetUp();
    ASSERT_TRUE(waitFor([this] {
      return views_.getNumSubscribers() > 0 && map_scale_.getNumSubscribers() > 0 && info_.getNumSubscribers() > 0 &&
             keyframes_.getNumSubscribers() > 0 && tf_static_.getNumSubscribers() > 0;
    }));
  }

  static double heightInMap(const synthetic::Scene& scene, double above_floor) {
    return (scene.T_world_ground_map.inverse() * Eigen::Vector3d(0, 0, above_floor)).z();
  }

  /// Shows on tf where the ground robot's camera is; returns the calibration that names its frame.
  sensor_msgs::CameraInfo placeCamera(const std::string& frame, double z) {
    geometry_msgs::TransformStamped T;
    T.header.stamp = ros::Time(now_);
    T.header.frame_id = "ground_map";
    T.child_frame_id = frame;
    T.transform.translation.z = z;
    T.transform.rotation.w = 1;
    tf2_msgs::TFMessage all;
    all.transforms.push_back(T);
    tf_static_.publish(all);
    sensor_msgs::CameraInfo info;
    info.header.stamp = T.header.stamp;
    info.header.frame_id = frame;
    return info;
  }

  AlignmentEstimate similarityMessage(const Similarity& T, const std::string& frame) const {
    AlignmentEstimate msg;
    msg.header.stamp = ros::Time(now_);
    msg.header.frame_id = frame;
    msg.child_frame_id = "mav_visual_map";
    msg.pose.pose = ros_utils::toMsg(poseOf(T));
    msg.scale = T.scale;
    msg.scale_stddev = 0.02 * T.scale;
    ros_utils::setCovariance(9e-4 * Matrix6d::Identity(), &msg.pose.covariance);
    msg.status = AlignmentEstimate::STATUS_CONVERGED;
    return msg;
  }

  /// A large table top over floor that the ground robot saw: a contradiction, unless its camera stands lower.
  synthetic::Scene sceneWithTable() const {
    auto scene = synthetic::makeScene(1);
    const Similarity T_mav_ground = inverse(scene.truth);
    for (double x = -1.2; x < 2.2; x += 0.025) {
      for (double y = -1.4; y < 1.4; y += 0.025) {
        const Eigen::Vector3d p_ground_map = scene.T_world_ground_map.inverse() * Eigen::Vector3d(x, y, 0.9);
        scene.aerial.points.push_back((T_mav_ground * p_ground_map).cast<float>());
      }
    }
    return scene;
  }

  void expectContradiction(const synthetic::Scene& scene) {
    sendScene(scene);
    ASSERT_TRUE(settle());
    estimates_.clear();
    sendCoarse(scene.T_ground_map_mav_map);
    ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_REJECTED)) << lastReason();
    EXPECT_NE(lastReason().find("heights contradict"), std::string::npos) << lastReason();
  }

  ros::Publisher map_scale_, info_, keyframes_, tf_static_, views_;
};

// The node has seen no map yet, nor a cloud. The images that both robots took are the guess, of scale and vertical too.
TEST_F(OwnUnitTest, ViewsStartTheRefinement) {
  const auto scene = synthetic::makeScene(5);
  const Similarity T_mav_visual{
      0.4, Eigen::AngleAxisd(-0.3, Eigen::Vector3d(0, 1, 0)).toRotationMatrix(), {0.1, 0.2, -0.3}};
  const Cloud visual = transformed(scene.aerial, inverse(T_mav_visual));
  const Similarity truth = compose(scene.truth, T_mav_visual);
  const Eigen::Vector3d centre = synthetic::centroid(visual);
  Similarity seen = truth;
  seen.scale *= 1.02;
  seen.t += truth * centre - seen * centre + Eigen::Vector3d(0.03, -0.04, 0.02);
  AlignmentEstimate msg = similarityMessage(seen, "ground_map");
  const Eigen::Vector3d at = truth * centre;
  msg.reference_point.x = at.x();
  msg.reference_point.y = at.y();
  msg.reference_point.z = at.z();
  views_.publish(msg);
  ASSERT_TRUE(settle());
  EXPECT_EQ(lastReason(), "waiting for aerial clouds");
  // Their author takes them back, and tells them once more.
  AlignmentEstimate withdrawn = msg;
  withdrawn.status = AlignmentEstimate::STATUS_AMBIGUOUS;
  views_.publish(withdrawn);
  ASSERT_TRUE(settle());
  EXPECT_EQ(lastReason(), "waiting for a coarse alignment or a manual guess");
  views_.publish(msg);
  ASSERT_TRUE(settle());
  ground_.publish(cloud(scene.ground, "ground_map"));
  aerial_.publish(cloud(visual, "mav_visual_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  EXPECT_NE(lastReason().find("images agree"), std::string::npos) << lastReason();
  const auto estimate = estimates_.back();
  const Similarity refined = similarity(ros_utils::fromMsg(estimate.pose.pose), estimate.scale);
  EXPECT_LT((refined * centre - truth * centre).norm(), 0.05);  // nearer than the images alone
  EXPECT_NEAR(std::log(refined.scale / truth.scale), 0, 0.011);
  aerial_.publish(cloud(scene.aerial, "mav_map"));  // metric again, for the tests to come
  ASSERT_TRUE(settle());
}

// A map in units of 2.5 m, 15 degrees from level; a coarse alignment that is 2.2 % too small and 0.12 m
// off.
TEST_F(OwnUnitTest, AnUnbiasedScaleComesOfABiasedGuess) {
  const auto scene = synthetic::makeScene(3);
  const Similarity T_mav_visual{
      2.5, Eigen::AngleAxisd(0.26, Eigen::Vector3d(0.6, -0.8, 0)).toRotationMatrix(), {0.3, -0.2, 0.9}};
  const Cloud visual = transformed(scene.aerial, inverse(T_mav_visual));
  const Similarity truth = compose(scene.truth, T_mav_visual);
  const Eigen::Vector3d centre = synthetic::centroid(visual);

  ASSERT_NO_FATAL_FAILURE(sendGround(scene.ground));
  aerial_.publish(cloud(visual, "mav_visual_map"));
  ASSERT_TRUE(settle());
  Similarity coarse = compose(similarity(offset(scene)), T_mav_visual);
  const Eigen::Vector3d at = coarse * centre;
  coarse.scale *= 1 - 0.022;
  coarse.t += at - coarse * centre;
  coarse_.publish(similarityMessage(coarse, "ground_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  const auto estimate = estimates_.back();
  EXPECT_EQ(estimate.child_frame_id, "mav_visual_map");
  const Similarity refined = similarity(ros_utils::fromMsg(estimate.pose.pose), estimate.scale);
  EXPECT_LT((refined * centre - truth * centre).norm(), 0.08);
  EXPECT_LT(air_ground_common::rotationAngle(refined.R, truth.R), 0.02);
  EXPECT_GT(estimate.scale_stddev, 0);
  EXPECT_NEAR(std::log(refined.scale / truth.scale), 0, 0.011);  // two standard deviations: drift of the ground map
  EXPECT_LT(std::abs(refined.scale - truth.scale), 3 * estimate.scale_stddev);

  // tf is about mav_map: it waits until the odometry says what that is.
  const Pose T_mav_map_base = air_ground_common::yawPose(0.4, T_mav_visual * centre + Eigen::Vector3d(0.3, 0.4, 1));
  sendOdometry(T_mav_map_base);
  EXPECT_TRUE(noTransformAfter(now_));
  EXPECT_TRUE(poses_.empty());
  map_scale_.publish(similarityMessage(T_mav_visual, "mav_map"));
  transforms_.clear();
  ASSERT_TRUE(waitFor([this] { return !transforms_.empty(); }));
  EXPECT_EQ(transforms_.back().header.frame_id, "ground_map");
  EXPECT_EQ(transforms_.back().child_frame_id, "mav_map");
  const Eigen::Vector3d middle = truth * centre;
  EXPECT_LT((lastTransform() * (T_mav_visual * centre) - middle).norm(), 0.1);
  sendOdometry(T_mav_map_base);
  ASSERT_TRUE(waitFor([this] { return !poses_.empty(); }));
  const Pose of_tf = lastTransform() * T_mav_map_base, told = ros_utils::fromMsg(poses_.back().pose.pose);
  EXPECT_LT((told.translation() - of_tf.translation()).norm(), 1e-6);
  EXPECT_LT(air_ground_common::rotationAngle(told.linear(), of_tf.linear()), 1e-6);

  // A reset forgets the alignment, not what it was told once about the map that goes on.
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros_utils::callService("/icp_refine/reset", reset));
  tick(1);
  aerial_.publish(cloud(visual, "mav_visual_map"));
  ASSERT_TRUE(settle());
  estimates_.clear();
  transforms_.clear();
  coarse_.publish(similarityMessage(coarse, "ground_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
  ASSERT_TRUE(waitFor([this] { return !transforms_.empty(); }));
  EXPECT_LT((lastTransform() * (T_mav_visual * centre) - middle).norm(), 0.1);

  // Metric again, for the tests to come.
  aerial_.publish(cloud(scene.aerial, "mav_map"));
  ASSERT_TRUE(settle());
}

// The map's scale is known from the clouds by then.
TEST_F(OwnUnitTest, AGuessOfAnotherScaleChangesNothingWhileAPoseIsTracked) {
  const auto scene = synthetic::makeScene(3);
  const Similarity T_mav_visual{2.5, Eigen::Matrix3d::Identity(), {0.3, -0.2, 0.9}};
  const Cloud visual = transformed(scene.aerial, inverse(T_mav_visual));
  const Similarity truth = compose(scene.truth, T_mav_visual);
  const Eigen::Vector3d centre = synthetic::centroid(visual);
  ASSERT_NO_FATAL_FAILURE(sendGround(scene.ground));
  aerial_.publish(cloud(visual, "mav_visual_map"));
  ASSERT_TRUE(settle());
  coarse_.publish(similarityMessage(truth, "ground_map"));
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();

  Similarity guess = truth;
  guess.scale *= 1.25;
  guess.t += truth * centre - guess * centre;
  tick(1);
  AlignmentEstimate msg = similarityMessage(guess, "ground_map");
  msg.status = AlignmentEstimate::STATUS_AMBIGUOUS;
  msg.guess = true;
  coarse_.publish(msg);
  ASSERT_TRUE(settle());
  tick(1);
  const ros::Time newest(now_);
  aerial_.publish(cloud(visual, "mav_visual_map"));
  ASSERT_TRUE(waitFor([&] { return !estimates_.empty() && estimates_.back().header.stamp == newest; }));
  EXPECT_EQ(estimates_.back().status, AlignmentEstimate::STATUS_CONVERGED) << lastReason();
  EXPECT_NEAR(estimates_.back().scale / truth.scale, 1, 0.01);

  aerial_.publish(cloud(scene.aerial, "mav_map"));  // metric again, for the tests to come
  ASSERT_TRUE(settle());
}

// Where tf does not lead to the camera: another node owns the robot's edges, or a parameter tells the mounting.
TEST_F(OwnUnitTest, TheGroundCamerasHeightComesFromKeyframes) {
  const auto scene = sceneWithTable();
  sensor_msgs::CameraInfo info;
  info.header.frame_id = "camera_that_tf_does_not_know";
  info_.publish(info);
  sendGroundStatus(4);
  ASSERT_TRUE(refresh());
  const int unknown = diagnostics_.counted("the ground camera's height is not known"),
            others = diagnostics_.counted("keyframes of another map");
  ASSERT_NO_FATAL_FAILURE(expectContradiction(scene));
  ASSERT_TRUE(awaitCount("the ground camera's height is not known", unknown + 1));

  air_ground::MapKeyframes keyframes;
  keyframes.header.stamp = ros::Time(now_);
  keyframes.header.frame_id = "ground_map";
  keyframes.map_id = 3;  // of a map that has ended: says nothing
  keyframes.ids = {1, 2, 5};
  keyframes.poses.resize(3);
  for (auto& pose : keyframes.poses) pose.orientation.w = 1;
  keyframes.poses[0].position.z = std::nan("");
  keyframes.poses[1].position.z = heightInMap(scene, 0.5);
  keyframes.poses[2].position.z = keyframes.poses[1].position.z - 0.1;
  keyframes_.publish(keyframes);
  ASSERT_TRUE(awaitCount("keyframes of another map", others + 1));
  ASSERT_NO_FATAL_FAILURE(expectContradiction(scene));

  keyframes.map_id = 4;
  keyframes_.publish(keyframes);
  ASSERT_TRUE(settle());
  sendCoarse(scene.T_ground_map_mav_map);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

// Drift of a map that has been corrected since, or one wrong transform.
TEST_F(OwnUnitTest, TheGroundCamerasHeightFallsWithItsKeyframes) {
  const auto scene = sceneWithTable();
  air_ground::MapKeyframes keyframes;
  keyframes.header.frame_id = "ground_map";
  keyframes.ids = {1};
  keyframes.poses.resize(1);
  keyframes.poses[0].orientation.w = 1;
  const auto send = [&](double above_floor) {
    tick(1);
    keyframes.header.stamp = ros::Time(now_);
    keyframes.poses[0].position.z = heightInMap(scene, above_floor);
    keyframes_.publish(keyframes);
  };
  send(1.5);
  ASSERT_NO_FATAL_FAILURE(expectContradiction(scene));
  send(0.5);
  ASSERT_TRUE(settle());
  sendCoarse(scene.T_ground_map_mav_map);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

// Without keyframes: what tf showed before a loop was closed tells nothing of the map since.
TEST_F(OwnUnitTest, TheGroundCamerasHeightIsThatOfTheCorrectedMap) {
  const auto scene = sceneWithTable();
  const auto sendHeight = [&](double above_floor) {
    tick(1);
    const auto info = placeCamera("ground_camera_of_a_corrected_map", heightInMap(scene, above_floor));
    pause(10);               // tf comes on a thread of its own ...
    ASSERT_TRUE(refresh());  // ... of a node that does not stand still meanwhile
    info_.publish(info);
  };
  sendGroundStatus(1, 0);
  ASSERT_NO_FATAL_FAILURE(sendHeight(1.5));
  ASSERT_NO_FATAL_FAILURE(expectContradiction(scene));
  ASSERT_NO_FATAL_FAILURE(sendHeight(0.5));
  ASSERT_NO_FATAL_FAILURE(expectContradiction(scene));
  const std::string corrected = "corrections of the map of the ground robot";
  const int corrections = countedNow(corrected);
  tick(1);
  sendGroundStatus(1, 1);
  ASSERT_TRUE(awaitCount(corrected, corrections + 1));  // forgets the height
  tick(1);
  ground_.publish(cloud(scene.ground, "ground_map"));
  ASSERT_NO_FATAL_FAILURE(sendHeight(0.5));
  ASSERT_TRUE(settle());
  sendCoarse(scene.T_ground_map_mav_map);
  ASSERT_TRUE(waitForStatus(AlignmentEstimate::STATUS_CONVERGED)) << lastReason();
}

TEST_F(OwnUnitTest, TheGroundCamerasHeightComesFromTf) {
  const auto scene = sceneWithTable();
  ASSERT_NO_FATAL_FAILURE(expectContradiction(scene));

  const auto info = placeCamera("ground_camera_optical_frame", heightInMap(scene, 0.5));
  ASSERT_TRUE(waitFor([&] {
    info_.publish(info);  // tf may need a moment
    sendCoarse(scene.T_ground_map_mav_map);
    return !estimates_.empty() && estimates_.back().status == AlignmentEstimate::STATUS_CONVERGED;
  })) << lastReason();
}

}  // namespace
}  // namespace icp_refine
