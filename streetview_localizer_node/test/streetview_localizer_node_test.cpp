// The node over a painted courtyard: what comes out, and what it does with a looped bag, missing calibration and bad
// input.
#include <air_ground/StreetviewMatch.h>
#include <diagnostic_msgs/DiagnosticStatus.h>
#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <gtest/gtest.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/static_transform_broadcaster.h>
#include <tf2_ros/transform_broadcaster.h>
#include <visualization_msgs/Marker.h>
#include <visualization_msgs/MarkerArray.h>

#include <cmath>
#include <cstdio>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/node_testing.h"
#include "tiny_city.h"

namespace streetview_localizer {
namespace {

using air_ground::StreetviewMatch;
using air_ground_common::Pose;
using test::TinyCity;
namespace ru = air_ground_common::ros_utils;
using ru::spinUntil;

// The camera is mounted off the body's centre, looks to the left and a little up.
Pose baseFromCamera() { return TinyCity::look({0.4, 0.3, -0.2}, M_PI / 2, 0.1); }

class StreetviewLocalizerNodeTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    city_ = new TinyCity(1);
    std::remove("tiny_city.gpkg");
    DatabaseWriter writer("tiny_city.gpkg", city_->model(), "test");
    const BackProjector projector(city_->model());
    for (const Panorama& place : city_->panoramas()) writer.add(place, city_->viewsOf(place, projector));
    writer.finish();
    mount_ = new tf2_ros::StaticTransformBroadcaster;
    geometry_msgs::TransformStamped edge;
    edge.header.frame_id = "mav_base_link";
    edge.child_frame_id = "mav_camera_optical_frame";
    edge.transform = ru::toTransformMsg(baseFromCamera());
    mount_->sendTransform(edge);
  }

  void SetUp() override {
    image_pub_ = handle_.advertise<sensor_msgs::Image>("mav/camera/image_raw", 5);
    info_pub_ = handle_.advertise<sensor_msgs::CameraInfo>("mav/camera/camera_info", 5);
    prior_pub_ = handle_.advertise<nav_msgs::Odometry>("tracked/odometry", 5);
    attitude_pub_ = handle_.advertise<nav_msgs::Odometry>("mav/odometry", 5);
    match_sub_ = handle_.subscribe<StreetviewMatch>(
        "streetview/match", 50, [this](const StreetviewMatch::ConstPtr& m) { matches_.push_back(*m); });
    pose_sub_ = handle_.subscribe<geometry_msgs::PoseWithCovarianceStamped>(
        "streetview/pose", 50,
        [this](const geometry_msgs::PoseWithCovarianceStamped::ConstPtr& m) { poses_.push_back(*m); });
    picture_sub_ = handle_.subscribe<sensor_msgs::Image>(
        "streetview/match_image", 5, [this](const sensor_msgs::Image::ConstPtr& m) { picture_ = *m; });
    view_sub_ = handle_.subscribe<sensor_msgs::Image>("streetview/synthesized_view", 5,
                                                      [this](const sensor_msgs::Image::ConstPtr& m) { view_ = *m; });
    model_sub_ = handle_.subscribe<sensor_msgs::PointCloud2>(
        "streetview/textured_model", 1, [this](const sensor_msgs::PointCloud2::ConstPtr& m) { model_ = *m; });
    panoramas_sub_ = handle_.subscribe<visualization_msgs::MarkerArray>(
        "streetview/panoramas", 1, [this](const visualization_msgs::MarkerArray::ConstPtr& m) { panoramas_ = *m; });
    cameras_sub_ = handle_.subscribe<visualization_msgs::Marker>(
        "streetview/cameras", 1, [this](const visualization_msgs::Marker::ConstPtr& m) { cameras_ = *m; });
    std_srvs::Trigger reset;
    ASSERT_TRUE(ru::callService("streetview_localizer/reset", reset)) << "the node did not come up with the database";
    EXPECT_TRUE(reset.response.success);
    ASSERT_TRUE(spinUntil([&] {
      return image_pub_.getNumSubscribers() && info_pub_.getNumSubscribers() && prior_pub_.getNumSubscribers() &&
             attitude_pub_.getNumSubscribers() && match_sub_.getNumPublishers() && pose_sub_.getNumPublishers() &&
             picture_sub_.getNumPublishers() && view_sub_.getNumPublishers() && model_;
    }));
  }

  static std_msgs::Header header(double stamp, const std::string& frame = "mav_camera_optical_frame") {
    std_msgs::Header h;
    h.stamp = ros::Time(stamp);
    h.frame_id = frame;
    return h;
  }

  /// True when the node has it.
  bool sendCalibration(double stamp, const std::string& frame = "mav_camera_optical_frame") {
    info_pub_.publish(ru::toMsg(TinyCity::camera(), header(stamp, frame)));
    return diagnostics_.awaitReceived(info_pub_.getTopic(), ros::Time(stamp));
  }

  /// True when the node has the predictions published so far: it counts one of another frame that comes after them.
  bool predictionsArrived(double stamp) {
    const std::string stray = "tracked poses ignored: in frame 'stray'";
    if (!diagnostics_.refresh()) return false;
    const int before = diagnostics_.counted(stray);
    prior_pub_.publish(odometry(stamp, "stray", Pose::Identity()));
    return diagnostics_.await(stray, before + 1);
  }

  static Pose cameraAt(const Pose& T_world_base) { return T_world_base * baseFromCamera(); }

  void sendImage(double stamp, const cv::Mat& image, const std::string& frame = "mav_camera_optical_frame") {
    image_pub_.publish(ru::toMsg(image, "bgr8", header(stamp, frame)));
  }

  bool awaitMatch(double stamp) {
    return spinUntil([&] { return !matches_.empty() && matches_.back().header.stamp == ros::Time(stamp); });
  }

  /// The camera on a gimbal that swings by 2 rad/s, and passes the mounting of the other tests at whole seconds.
  void sendGimbal(double stamp, const std::string& frame) {
    geometry_msgs::TransformStamped edge;
    edge.header = header(stamp, "mav_base_link");
    edge.child_frame_id = frame;
    edge.transform = ru::toTransformMsg(
        TinyCity::look(baseFromCamera().translation(), M_PI / 2 + 2 * (stamp - std::round(stamp)), 0.1));
    gimbal_.sendTransform(edge);
  }

  static nav_msgs::Odometry odometry(double stamp, const std::string& frame, const Pose& T) {
    nav_msgs::Odometry m;
    m.header.stamp = ros::Time(stamp);
    m.header.frame_id = frame;
    m.child_frame_id = "mav_base_link";
    m.pose.pose = ru::toMsg(T);
    for (std::size_t k = 0; k < 6; ++k) m.pose.covariance[7 * k] = k < 3 ? 1.0 : 0.01;
    return m;
  }

  ros::NodeHandle handle_;
  tf2_ros::TransformBroadcaster gimbal_;
  ros::Publisher image_pub_, info_pub_, prior_pub_, attitude_pub_;
  ros::Subscriber match_sub_, pose_sub_, picture_sub_, view_sub_, model_sub_, panoramas_sub_, cameras_sub_;
  std::vector<StreetviewMatch> matches_;
  std::vector<geometry_msgs::PoseWithCovarianceStamped> poses_;
  std::optional<sensor_msgs::Image> picture_, view_;
  std::optional<sensor_msgs::PointCloud2> model_;
  std::optional<visualization_msgs::MarkerArray> panoramas_;
  std::optional<visualization_msgs::Marker> cameras_;
  ru::NodeDiagnostics diagnostics_{"streetview_localizer"};
  static TinyCity* city_;
  static tf2_ros::StaticTransformBroadcaster* mount_;
};

TinyCity* StreetviewLocalizerNodeTest::city_ = nullptr;
tf2_ros::StaticTransformBroadcaster* StreetviewLocalizerNodeTest::mount_ = nullptr;

// In order: the node has no calibration before this test sends one.
TEST_F(StreetviewLocalizerNodeTest, AWaitsForCalibration) {
  sendImage(1, cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(100)));
  EXPECT_TRUE(diagnostics_.await("images without calibration", 1));
  EXPECT_TRUE(matches_.empty());
}

TEST_F(StreetviewLocalizerNodeTest, BodyPoseInWorld) {
  const Pose T_world_base = air_ground_common::yawPose(0.05, {-3, 0.5, 4});
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(T_world_base));
  ASSERT_TRUE(sendCalibration(10));
  // A level frame of its own origin and heading tells roll and pitch.
  attitude_pub_.publish(odometry(10, "mav_map", air_ground_common::yawPose(2.0, {5, 5, 5}) * T_world_base));
  sendImage(10, image);
  ASSERT_TRUE(awaitMatch(10));
  const StreetviewMatch& m = matches_.back();
  EXPECT_EQ(m.status, StreetviewMatch::STATUS_ACCEPTED) << m.reason;
  EXPECT_EQ(m.header.frame_id, "world");
  EXPECT_FALSE(m.used_prior);
  EXPECT_EQ(m.camera_frame, "mav_camera_optical_frame");
  EXPECT_EQ(m.panorama_id.substr(0, 5), "pano_");
  EXPECT_EQ(m.points.size(), m.inliers);
  ASSERT_GE(m.points.size(), 12u);
  const Pose T_world_camera = ru::fromMsg(m.camera_pose.pose);
  EXPECT_LT((T_world_camera.translation() - cameraAt(T_world_base).translation()).norm(), 0.1);
  for (const auto& p : m.points) {
    const auto pixel =
        TinyCity::camera().project(T_world_camera.inverse() * Eigen::Vector3d(p.point.x, p.point.y, p.point.z));
    ASSERT_TRUE(pixel);
    EXPECT_LT((*pixel - Eigen::Vector2d(p.u, p.v)).norm(), 8);
  }
  ASSERT_TRUE(spinUntil([&] { return !poses_.empty(); }));
  EXPECT_EQ(poses_.back().header.stamp, ros::Time(10));
  EXPECT_EQ(poses_.back().header.frame_id, "world");
  const Pose T = ru::fromMsg(poses_.back().pose.pose);
  EXPECT_LT((T.translation() - T_world_base.translation()).norm(), 0.1);
  EXPECT_LT(air_ground_common::rotationAngle(T.linear(), T_world_base.linear()), 0.01);
  const auto covariance = ru::covarianceFromMsg(poses_.back().pose.covariance);
  EXPECT_EQ(Eigen::LLT<air_ground_common::Matrix6d>(covariance).info(), Eigen::Success);
  EXPECT_LT(covariance(0, 0) + covariance(1, 1) + covariance(2, 2), 1.0);
  // The body swings about the camera: each standard deviation of the camera's pose, applied to it, moves the body so.
  const Eigen::Vector3d lever = T.translation() - T_world_camera.translation();
  EXPECT_NEAR(lever.norm(), baseFromCamera().translation().norm(), 1e-6);
  const air_ground_common::Matrix6d of_camera = ru::covarianceFromMsg(m.camera_pose.covariance);
  const air_ground_common::Matrix6d L = of_camera.llt().matrixL();
  air_ground_common::Matrix6d of_body = air_ground_common::Matrix6d::Zero();
  for (int k = 0; k < 6; ++k) {
    air_ground_common::Vector6d e = L.col(k);
    e.head<3>() += Eigen::Vector3d(e.tail<3>()).cross(lever);
    of_body += e * e.transpose();
  }
  EXPECT_LT((covariance - of_body).norm(), 1e-6 * of_body.norm());

  EXPECT_TRUE(spinUntil([&] { return picture_ && view_ && panoramas_ && cameras_; }));
  EXPECT_EQ(picture_->encoding, "bgr8");
  EXPECT_EQ(panoramas_->markers.size(), 6u);
  EXPECT_EQ(cameras_->points.size(), 16u);
  EXPECT_GT(model_->width * model_->height, 1000u);
}

TEST_F(StreetviewLocalizerNodeTest, PriorChoosesThePanoramas) {
  const Pose T_world_base = air_ground_common::yawPose(0.1, {4, 0, 3.5});
  ASSERT_TRUE(sendCalibration(20));
  Pose predicted = T_world_base;
  predicted.translation() += Eigen::Vector3d(1, 1, 0.5);
  prior_pub_.publish(odometry(20, "world", predicted));
  attitude_pub_.publish(odometry(20, "mav_map", T_world_base));
  ASSERT_TRUE(predictionsArrived(20));
  sendImage(20, city_->photograph(TinyCity::camera(), cameraAt(T_world_base)));
  ASSERT_TRUE(awaitMatch(20));
  EXPECT_TRUE(matches_.back().used_prior);
  EXPECT_EQ(matches_.back().searched, std::vector<std::string>{"pano_2.jpg"});  // near_panoramas: 1
  EXPECT_EQ(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED) << matches_.back().reason;
  ASSERT_TRUE(spinUntil([&] { return !poses_.empty(); }));
  EXPECT_LT((ru::fromMsg(poses_.back().pose.pose).translation() - T_world_base.translation()).norm(), 0.1);
}

TEST_F(StreetviewLocalizerNodeTest, RefusesAndGoesOn) {
  ASSERT_TRUE(sendCalibration(30));
  sendImage(30, cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(0)));
  ASSERT_TRUE(awaitMatch(30));
  EXPECT_NE(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED);
  EXPECT_FALSE(matches_.back().reason.empty());
  EXPECT_TRUE(matches_.back().points.empty());

  // Not finite, in the wrong frame, of the wrong size, uncalibrated: counted, nothing falls over.
  nav_msgs::Odometry bad = odometry(31, "world", Pose::Identity());
  bad.pose.pose.position.x = std::numeric_limits<double>::quiet_NaN();
  prior_pub_.publish(bad);
  prior_pub_.publish(odometry(31, "elsewhere", Pose::Identity()));
  bad = odometry(31, "mav_map", Pose::Identity());
  bad.pose.pose.orientation.w = std::numeric_limits<double>::quiet_NaN();
  attitude_pub_.publish(bad);
  nav_msgs::Odometry foreign = odometry(31, "world", Pose::Identity());
  foreign.child_frame_id = "rgbd_base_link";
  prior_pub_.publish(foreign);
  attitude_pub_.publish(foreign);
  sensor_msgs::CameraInfo uncalibrated = ru::toMsg(TinyCity::camera(), header(31));
  uncalibrated.K[0] = 0;
  info_pub_.publish(uncalibrated);
  sendImage(31, cv::Mat(100, 100, CV_8UC3, cv::Scalar::all(0)));
  for (const char* event :
       {"tracked pose ignored: of frame 'rgbd_base_link'", "tracked poses ignored: in frame 'elsewhere'",
        "attitude ignored: of frame 'rgbd_base_link'", "calibration ignored", "images of another size"}) {
    EXPECT_TRUE(diagnostics_.await(event, 1)) << event;
  }
  EXPECT_TRUE(diagnostics_.await("tracked pose ignored", 2));  // the one that is not finite
  EXPECT_TRUE(diagnostics_.await("attitude ignored", 2));

  // A prediction whose covariance is none: the image is worked on without it.
  const Pose T_world_base = air_ground_common::yawPose(0.05, {-3, 0.5, 4});
  nav_msgs::Odometry indefinite = odometry(32, "world", T_world_base);
  indefinite.pose.covariance[1] = indefinite.pose.covariance[6] = 2;
  prior_pub_.publish(indefinite);
  ASSERT_TRUE(predictionsArrived(32));
  sendImage(32, city_->photograph(TinyCity::camera(), cameraAt(T_world_base)));
  ASSERT_TRUE(awaitMatch(32));
  EXPECT_EQ(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED) << matches_.back().reason;
  EXPECT_FALSE(matches_.back().used_prior);
  EXPECT_TRUE(spinUntil([&] { return poses_.size() == 1; }));
  EXPECT_TRUE(diagnostics_.await("tracked poses ignored: covariance not positive definite", 1));
}

TEST_F(StreetviewLocalizerNodeTest, WorksOnTheNewestImage) {
  ASSERT_TRUE(sendCalibration(40));
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(air_ground_common::yawPose(0.05, {-3, 0.5, 4})));
  for (int i = 0; i < 6; ++i) {
    sendImage(40 + 0.1 * i, image);
    ru::pause(4);
  }
  ASSERT_TRUE(awaitMatch(40.5));
  EXPECT_LT(matches_.size(), 6u);
  EXPECT_TRUE(diagnostics_.await("images skipped for newer ones while one was worked on", 1));
}

// A tracker that is sure of a place 60 m off must not keep the localizer from the right one.
TEST_F(StreetviewLocalizerNodeTest, WrongPredictionIsSetAside) {
  ASSERT_TRUE(sendCalibration(42));
  const Pose T_world_base = air_ground_common::yawPose(0.05, {-3, 0.5, 4});
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(T_world_base));
  Pose wrong = T_world_base;
  wrong.translation() += Eigen::Vector3d(0, 60, 0);
  const int misses = 3;  // prior_misses
  for (int i = 0; i <= misses; ++i) prior_pub_.publish(odometry(42 + i, "world", wrong));
  ASSERT_TRUE(predictionsArrived(42 + misses));
  for (int i = 0; i <= misses; ++i) {
    const double stamp = 42 + i;
    sendImage(stamp, image);
    ASSERT_TRUE(awaitMatch(stamp));
    EXPECT_EQ(matches_.back().used_prior, i < misses);
    EXPECT_EQ(matches_.back().status == StreetviewMatch::STATUS_ACCEPTED, i == misses) << matches_.back().reason;
  }
  ASSERT_TRUE(spinUntil([&] { return !poses_.empty(); }));
  EXPECT_LT((ru::fromMsg(poses_.back().pose.pose).translation() - T_world_base.translation()).norm(), 0.1);
}

// Recordings of tf's first version name frames with a slash; some drivers name them in camera_info alone.
TEST_F(StreetviewLocalizerNodeTest, FrameNamesOfOthersGiveAFix) {
  const Pose T_world_base = air_ground_common::yawPose(0.05, {-3, 0.5, 4});
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(T_world_base));
  double stamp = 46;
  for (const auto& [of_info, of_image] : {std::pair<std::string, std::string>{"", "/mav_camera_optical_frame"},
                                          {"/mav_camera_optical_frame", ""},
                                          {"mav_camera_optical_frame", ""}}) {
    ASSERT_TRUE(sendCalibration(++stamp, of_info));
    sendImage(stamp, image, of_image);
    ASSERT_TRUE(awaitMatch(stamp));
    EXPECT_EQ(matches_.back().camera_frame, "mav_camera_optical_frame");
    ASSERT_TRUE(spinUntil([&] { return !poses_.empty() && poses_.back().header.stamp == ros::Time(stamp); }))
        << "'" << of_info << "' '" << of_image << "'";
    EXPECT_LT((ru::fromMsg(poses_.back().pose.pose).translation() - T_world_base.translation()).norm(), 0.1);
  }
}

TEST_F(StreetviewLocalizerNodeTest, WithoutMountingItSaysThatThereIsNoFix) {
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(air_ground_common::yawPose(0.05, {-3, 0.5, 4})));
  double stamp = 56;
  for (const auto& [frame, why] :
       {std::pair<std::string, std::string>{"nowhere", "no transform from 'nowhere' to 'mav_base_link'"},
        {"", "neither images nor camera_info name a frame"}}) {
    ASSERT_TRUE(sendCalibration(++stamp, frame));
    sendImage(stamp, image, frame);
    ASSERT_TRUE(awaitMatch(stamp));
    EXPECT_EQ(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED) << matches_.back().reason;
    EXPECT_TRUE(spinUntil([&] { return diagnostics_.message().find("located, but " + why) == 0; }))
        << diagnostics_.message();
    EXPECT_NE(diagnostics_.level(), diagnostic_msgs::DiagnosticStatus::OK);  // on a busy machine images are missed, too
    EXPECT_TRUE(diagnostics_.await("images without prior and fix: " + why, 1));
  }
  EXPECT_TRUE(poses_.empty());
}

// As the camera was at the image's time, not as it is when the worker comes to it. tf and images have no order.
TEST_F(StreetviewLocalizerNodeTest, GimbalIsTakenAtTheImagesTime) {
  const std::string frame = "mav_gimbal";
  const Pose T_world_base = air_ground_common::yawPose(0.05, {-3, 0.5, 4});
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(T_world_base));
  ASSERT_TRUE(sendCalibration(70, frame));
  for (int stamp = 70; poses_.empty() && stamp < 90; ++stamp) {
    sendGimbal(stamp - 0.1, frame);
    sendGimbal(stamp + 0.1, frame);
    sendImage(stamp, image, frame);
    ASSERT_TRUE(awaitMatch(stamp));
    ru::pause(4);
  }
  ASSERT_FALSE(poses_.empty());
  const Pose T = ru::fromMsg(poses_.back().pose.pose);
  EXPECT_LT((T.translation() - T_world_base.translation()).norm(), 0.1);
  EXPECT_LT(air_ground_common::rotationAngle(T.linear(), T_world_base.linear()), 0.01);
}

TEST_F(StreetviewLocalizerNodeTest, GimbalThatIsNotHeardOfAnyMoreGivesNoFix) {
  const std::string frame = "mav_silent_gimbal",
                    lacking =
                        "images without prior and fix: the transform from 'mav_silent_gimbal' to "
                        "'mav_base_link' is not known at the image's time: publish it on /tf";
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(air_ground_common::yawPose(0.05, {-3, 0.5, 4})));
  ASSERT_TRUE(sendCalibration(100, frame));
  sendGimbal(100, frame);
  for (int stamp = 101; diagnostics_.counted(lacking) == 0 && stamp < 120; ++stamp) {
    sendImage(stamp, image, frame);
    ASSERT_TRUE(awaitMatch(stamp));
    EXPECT_EQ(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED) << matches_.back().reason;
    ASSERT_TRUE(diagnostics_.refresh());
  }
  EXPECT_TRUE(diagnostics_.await(lacking, 1));
  EXPECT_TRUE(poses_.empty());
}

// A camera of 10 bits in messages of 16, which fills them from below.
TEST_F(StreetviewLocalizerNodeTest, TenBitsAreNotBlack) {
  const Pose T_world_base = air_ground_common::yawPose(0.05, {-3, 0.5, 4});
  cv::Mat grey;
  cv::cvtColor(city_->photograph(TinyCity::camera(), cameraAt(T_world_base)), grey, cv::COLOR_BGR2GRAY);
  grey.convertTo(grey, CV_16U, 4);
  ASSERT_TRUE(sendCalibration(130));
  image_pub_.publish(ru::toMsg(grey, "mono16", header(130)));
  ASSERT_TRUE(awaitMatch(130));
  EXPECT_EQ(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED) << matches_.back().reason;
}

TEST_F(StreetviewLocalizerNodeTest, SurvivesALoopedBag) {
  ASSERT_TRUE(sendCalibration(140));
  const cv::Mat image = city_->photograph(TinyCity::camera(), cameraAt(air_ground_common::yawPose(0.05, {-3, 0.5, 4})));
  sendImage(140, image);
  ASSERT_TRUE(awaitMatch(140));
  sendImage(4, cv::Mat(image.size(), CV_8UC3, cv::Scalar::all(0)));
  ASSERT_TRUE(awaitMatch(4));
  ASSERT_TRUE(diagnostics_.refresh());
  EXPECT_EQ(diagnostics_.message().find("last fix"), std::string::npos) << diagnostics_.message();
  sendImage(5, image);
  ASSERT_TRUE(awaitMatch(5));
  EXPECT_EQ(matches_.back().status, StreetviewMatch::STATUS_ACCEPTED) << matches_.back().reason;
  EXPECT_TRUE(diagnostics_.await("time jumped back: started afresh", 1));
}

}  // namespace
}  // namespace streetview_localizer

int main(int argc, char** argv) {
  ::testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "streetview_localizer_node_test");
  ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
