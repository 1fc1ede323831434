// The shell of a robot's motion estimator around a stand-in: nothing that it throws ends the worker, and services may
// be called from any thread meanwhile. Started by estimator_shell.test.
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <tf2_ros/static_transform_broadcaster.h>
#include <tf2_ros/transform_broadcaster.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <stdexcept>
#include <thread>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/estimator_shell.h"
#include "air_ground_common/ros/node_testing.h"

namespace air_ground_common::ros_utils {
namespace {

void waitWhile(const std::atomic<bool>& busy) {
  while (busy) std::this_thread::sleep_for(std::chrono::milliseconds(5));
}

/// Counts what it is given. Called by the shell with its lock held: what is not atomic is read after stop() alone.
class StandIn : public Estimator {
 public:
  bool exists() const override { return made_; }
  void make(const CameraModel&, const Pose&, const std::optional<Pose>&) override { made_ = true; }
  std::uint32_t mapId() const override { return map_id_; }
  void forgetMap() override {}
  void keep() override {
    if (fail_keep.exchange(false)) throw std::bad_alloc();
  }
  void drop() override { made_ = false; }
  void reset() override {
    ++map_id_;
    ++resets;
  }
  bool addImu(const ImuInput::Sample& sample) override {
    ++samples;
    const bool later = sample.stamp > last_sample_;
    if (!later) ++disorder;
    last_sample_ = sample.stamp;
    return later;
  }
  EstimatorResult process(const EstimatorFrame& frame) override {
    if (fail) throw std::runtime_error("this one is spoilt");
    waitWhile(held);
    if (frame.depth && frame.depth->encoding == "16UC1") ++depths;
    ++images;
    EstimatorResult result;
    result.pose_published = true;
    result.publish = [this] { ++published; };
    return result;
  }
  void idle() override {
    if (fail_idle.exchange(false)) throw std::bad_alloc();
  }
  std::function<std::vector<CloudPoint>()> mapForFile() override {
    return [this] {
      ++saving;
      waitWhile(slow);
      return std::vector<CloudPoint>(1);
    };
  }
  std::vector<MapTrajectory> trajectories() override {
    const Trajectory pose(1);
    return {{pose, "", 9}, {pose, "", 8}, {pose, "", 7}};
  }

  std::atomic<bool> fail{false}, fail_idle{false}, fail_keep{false}, slow{false}, held{false};
  std::atomic<int> saving{0}, images{0}, published{0}, depths{0}, samples{0}, disorder{0}, resets{0};

 private:
  bool made_ = false;
  std::uint32_t map_id_ = 1;
  double last_sample_ = 0;
};

class Shell : public testing::Test {
 protected:
  Shell() {
    settings_.map_frame = "map", settings_.odom_frame = "odom", settings_.base_frame = "base";
    settings_.T_base_camera = settings_.T_base_imu = Pose::Identity();
    settings_.accel_topic = "accel";
    settings_.max_latency = 0;
    start();
    image_ = handle_.advertise<sensor_msgs::Image>("image", 100);
    info_ = handle_.advertise<sensor_msgs::CameraInfo>("camera_info", 10);
    gyro_ = handle_.advertise<sensor_msgs::Imu>("imu", 1000);
    accel_ = handle_.advertise<sensor_msgs::Imu>("accel", 1000);
  }

  void start(const std::string& depth = "") {
    shell_.reset();
    shell_.emplace(handle_, settings_,
                   EstimatorNames{"image", "camera_info", "imu", "status", depth, "shell", "estimation", "", "", ""},
                   estimator_);
    shell_->start();
  }

  /// A tenth of a second: an image, and the two streams of the IMU at 100 Hz and 200 Hz.
  void publish(int i) {
    const double stamp = 100 + 0.1 * i;
    CameraModel camera;
    camera.width = 8, camera.height = 6;
    camera.fx = camera.fy = 5, camera.cx = 3.5, camera.cy = 2.5;
    std_msgs::Header header;
    header.stamp = ros::Time(stamp);
    info_.publish(toMsg(camera, header));
    for (int k = 0; k < 20; ++k) {
      sensor_msgs::Imu msg;
      msg.header.stamp = ros::Time(stamp + 0.005 * k);
      msg.linear_acceleration.z = 9.81;
      accel_.publish(msg);
      if (k % 2 == 0) gyro_.publish(msg);
    }
    cv::Mat pixels(6, 8, CV_8UC1, cv::Scalar(0));
    pixels.at<std::uint8_t>(3, 3) = grey_ = static_cast<std::uint8_t>(grey_ + grey_step_);
    image_.publish(toMsg(pixels, "mono8", header));
  }

  bool publishUntil(const std::function<bool()>& done) {
    return spinUntil([&] {
      publish(next_++);
      return done();
    });
  }

  ros::NodeHandle handle_;
  EstimatorSettings settings_;
  StandIn estimator_;
  std::optional<EstimatorShell> shell_;
  ros::Publisher image_, info_, gyro_, accel_;
  int next_ = 0;
  std::uint8_t grey_ = 0, grey_step_ = 0;  ///< of a pixel
};

TEST_F(Shell, NothingThatTheEstimatorThrowsEndsTheWorker) {
  ASSERT_TRUE(publishUntil([&] { return estimator_.images > 3; }));
  estimator_.fail = true;
  ASSERT_TRUE(publishUntil([&] { return shell_->health().counted("images refused: this one is spoilt") > 0; }));
  estimator_.fail = false;
  estimator_.fail_idle = true;
  ASSERT_TRUE(spinUntil([&] { return !estimator_.fail_idle; }));  // no more images
  const int before = estimator_.images;
  EXPECT_TRUE(publishUntil([&] { return estimator_.images > before; })) << "it works on";
  // A recording begins again, and what there was cannot be kept.
  estimator_.fail_keep = true;
  next_ = -500;
  ASSERT_TRUE(publishUntil([&] {
    return shell_->health().counted("a map that ended is not kept: std::bad_alloc") > 0 && estimator_.resets;
  }));
  const int images = estimator_.images;
  EXPECT_TRUE(publishUntil([&] { return estimator_.images > images; })) << "the time that comes counts";
}

TEST_F(Shell, ADriverThatHangsIsNamedAndItsImagesMoveNoEstimate) {
  air_ground::VoStatus said;
  const ros::Subscriber status = handle_.subscribe<air_ground::VoStatus>(
      "status", 100, [&](const air_ground::VoStatus::ConstPtr& msg) { said = *msg; });
  grey_step_ = 60;
  ASSERT_TRUE(publishUntil([&] { return estimator_.images > 3; }));
  grey_step_ = 0;
  ASSERT_TRUE(publishUntil([&] { return said.reason.find("the same, pixel by pixel, for") != std::string::npos; }));
  const int before = estimator_.images, samples = estimator_.samples;
  ASSERT_TRUE(publishUntil([&] { return estimator_.samples > samples + 100; })) << "the IMU's go on";
  EXPECT_EQ(estimator_.images, before);
  EXPECT_GT(
      shell_->health().counted("images left out: their pixels are those of the image before, and the robot moves"), 5u);
  grey_step_ = 60;
  EXPECT_TRUE(publishUntil([&] { return estimator_.images > before && said.reason.empty(); }));
}

TEST_F(Shell, ServicesThatTakeLongHoldUpNoInput) {
  ASSERT_TRUE(publishUntil([&] { return estimator_.images > 3; }));
  estimator_.slow = true;
  std::vector<std::thread> users;
  for (int i = 0; i < 3; ++i)
    users.emplace_back([i] {
      air_ground::SaveMap map;
      map.request.path = testing::TempDir() + "held_" + std::to_string(getpid()) + std::to_string(i) + ".ply";
      EXPECT_TRUE(ros::service::call(ros::this_node::getName() + "/save_map", map) && map.response.success);
      std::filesystem::remove(map.request.path);
    });
  EXPECT_TRUE(publishUntil([&] { return estimator_.saving > 0; }));
  const int before = estimator_.images;
  EXPECT_TRUE(publishUntil([&] { return estimator_.images > before + 5; }));
  estimator_.slow = false;
  for (std::thread& user : users) user.join();
}

// Without calibration images wait.
TEST_F(Shell, ImagesThatWaitTakeNoMoreThanTheQueuesMemory) {
  settings_.queue_memory = 1;  // [MB]
  start();
  const std::string dropped = "images dropped: the queue held queue_memory";
  std_msgs::Header header;
  ASSERT_TRUE(spinUntil([&] {
    header.stamp = ros::Time(200 + 0.1 * next_++);
    image_.publish(toMsg(cv::Mat(600, 1000, CV_8UC1, cv::Scalar(0)), "mono8", header));
    return shell_->health().counted(dropped) > 3;
  }));
  EXPECT_EQ(shell_->health().counted("images dropped: the queue was full"), 0u);
}

TEST_F(Shell, SaysWhetherDepthIsMissingOutOfStepOrOver) {
  std::string reason;
  const auto status = handle_.subscribe<air_ground::VoStatus>(
      "status", 10, [&](const air_ground::VoStatus::ConstPtr& msg) { reason = msg->reason; });
  const ros::Publisher depth = handle_.advertise<sensor_msgs::Image>("depth", 10);
  settings_.use_imu = false;
  start("depth");
  EXPECT_TRUE(publishUntil([&] { return !reason.empty(); }));
  EXPECT_EQ(reason, "no depth image has come on /depth");
  EXPECT_TRUE(publishUntil([&] {
    std_msgs::Header header;
    header.stamp = ros::Time(90 + 0.1 * next_);  // of another clock
    depth.publish(toMsg(cv::Mat(6, 8, CV_16UC1, cv::Scalar(1500)), "16UC1", header));
    return reason.find("missed by -") != std::string::npos;
  })) << reason;
  EXPECT_TRUE(publishUntil([&] { return reason.find("no depth image has come on /depth for ") == 0; })) << reason;
}

// Whoever has heard of the map before must not take the new one for it, though a new master knows of no start.
TEST_F(Shell, EachStartNumbersItsMapsAnew) {
  std::set<std::uint32_t> ids;
  for (int i = 0; i < 5; ++i) {
    ros::NodeHandle("~").deleteParam("starts");
    start();
    ids.insert(shell_->mapId());
    EXPECT_EQ(shell_->mapId() % 10000, 1u);
  }
  EXPECT_EQ(ids.size(), 5u);
}

TEST_F(Shell, InAReplayTheStartsAreCounted) {
  ros::NodeHandle("~").deleteParam("starts");
  ros::Time::setNow(ros::Time(5.0));
  for (const std::uint32_t id : {1, 10001, 20001}) {
    start();
    EXPECT_EQ(shell_->mapId(), id);
  }
  ros::Time::init();
}

// A bag that is played with nobody to hold the player goes on as the world does.
TEST_F(Shell, OfAReplayLateImagesAreDroppedUnlessThePlayerWaits) {
  ros::Time::setNow(ros::Time(5.0));
  settings_.max_latency = 1;
  const auto late = [&] { return shell_->health().counted("images dropped: further behind than max_latency"); };
  for (const bool waits : {true, false}) {
    settings_.player_waits = waits;
    start();
    const int before = estimator_.images;
    ASSERT_TRUE(publishUntil([&] { return estimator_.images > before + 3; }));
    const int held = estimator_.images;
    estimator_.held = true;
    for (int i = 0; i < 50; ++i) publish(next_++);  // five seconds at once
    pause(100);
    estimator_.held = false;
    EXPECT_TRUE(spinUntil([&] { return waits ? estimator_.images > held + 45 : late() > 30; }));
    EXPECT_EQ(late() == 0, waits);
  }
  ros::Time::init();
}

TEST_F(Shell, AnswersWithThePathFromTheRoot) {
  const std::string home = testing::TempDir() + "home of this test";
  std::filesystem::create_directories(home);
  const char* before = std::getenv("HOME");
  setenv("HOME", home.c_str(), 1);
  ASSERT_TRUE(publishUntil([&] { return estimator_.images > 3; }));
  ros::AsyncSpinner spinner(1);
  spinner.start();
  air_ground::SaveMap map;
  map.request.path = "~/map.ply";
  ASSERT_TRUE(ros::service::call(ros::this_node::getName() + "/save_map", map));
  EXPECT_TRUE(map.response.success);
  EXPECT_NE(map.response.message.find(" written to " + home + "/map.ply"), std::string::npos) << map.response.message;
  EXPECT_TRUE(std::filesystem::exists(home + "/map.ply"));
  if (before) setenv("HOME", before, 1);
  std::filesystem::remove_all(home);
}

// An estimator may save a map when it ends, by the name that it has here.
TEST_F(Shell, MapsThatEndedHaveTheirIdsAndAreSavedOnce) {
  namespace fs = std::filesystem;
  settings_.autosave = testing::TempDir() + "maps_" + std::to_string(getpid());
  start();
  ASSERT_TRUE(publishUntil([&] { return estimator_.images > 3; }));
  shell_->autosave().save("trajectory_map7.txt",
                          [](const std::string& path) { std::ofstream(path) << "# saved before\n"; });
  shell_->stop();
  const auto poses = [&](const std::string& end) {  // in the one file whose name ends so; -1: there is none
    for (const auto& entry : fs::directory_iterator(settings_.autosave)) {
      const std::string path = entry.path();
      if (path.rfind(end) == path.size() - end.size()) return static_cast<int>(readTum(path).size());
    }
    return -1;
  };
  EXPECT_EQ(poses("_trajectory.txt"), 1);
  EXPECT_EQ(poses("_trajectory_map8.txt"), 1);
  EXPECT_EQ(poses("_trajectory_map7.txt"), 0) << "it was there";
  fs::remove_all(settings_.autosave);
}

geometry_msgs::TransformStamped edge(const std::string& parent, const std::string& child) {
  geometry_msgs::TransformStamped msg;
  msg.header.stamp = ros::Time::now();
  msg.header.frame_id = parent;
  msg.child_frame_id = child;
  msg.transform = toTransformMsg(Pose::Identity());
  return msg;
}

/// A node of its own, which says where frames of the shell are.
void beRival() {
  tf2_ros::StaticTransformBroadcaster fixed;
  fixed.sendTransform(edge("mast", "static_base"));
  tf2_ros::TransformBroadcaster moving;
  while (ros::ok()) {
    moving.sendTransform(
        std::vector<geometry_msgs::TransformStamped>{edge("gps", "shared_base"), edge("gps", "shared_odom")});
    ros::WallDuration(0.1).sleep();
  }
}

// A head that pans: where the base is follows from the camera no more.
TEST_F(Shell, WithholdsPosesOfABaseThatTheCameraMovesAgainst) {
  settings_.base_frame = "torso", settings_.camera_frame = "head";
  settings_.T_base_camera.reset();
  start();
  tf2_ros::TransformBroadcaster neck;
  const auto pan = [&](double angle) {
    auto msg = edge("torso", "head");
    msg.transform = toTransformMsg(Pose(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ())));
    neck.sendTransform(msg);
  };
  NodeDiagnostics diagnostics(ros::this_node::getName().substr(1));
  ASSERT_TRUE(publishUntil([&] {
    pan(0.005);
    return estimator_.published > 3;
  }));
  ASSERT_TRUE(publishUntil([&] {
    pan(0.3);
    return diagnostics.message().find("'head' has moved against 'torso' by 16.9 deg") != std::string::npos;
  })) << diagnostics.message();
  const int before = estimator_.published, images = estimator_.images;
  ASSERT_TRUE(publishUntil([&] { return estimator_.images > images + 3; }));
  EXPECT_EQ(estimator_.published, before);
  EXPECT_TRUE(publishUntil([&] {
    pan(0);
    return estimator_.published > before;
  })) << "it looks ahead again";
}

TEST_F(Shell, CountsWhoElsePlacesItsFrames) {
  const std::string on_base = "/rival publishes 'gps' -> 'shared_base' on tf",
                    on_odom = "/rival publishes 'gps' -> 'shared_odom' on tf";
  settings_.odom_frame = "shared_odom", settings_.base_frame = "/shared_base";
  start();
  tf2_ros::TransformBroadcaster own;
  NodeDiagnostics diagnostics(ros::this_node::getName().substr(1));
  EXPECT_TRUE(spinUntil([&] {
    own.sendTransform(edge("shared_odom", "shared_base"));
    return diagnostics.counted(on_base) > 2 && diagnostics.counted(on_odom) > 2;
  }));
  EXPECT_EQ(diagnostics.counted(ros::this_node::getName() + " publishes"), 0) << "this node itself";

  settings_.odom_from_tf = true;
  start();
  const auto begun = [&] { return diagnostics.message().find("waiting for images") != std::string::npos; };
  EXPECT_TRUE(diagnostics.refresh() && begun());
  EXPECT_TRUE(diagnostics.await(on_odom, 3));
  EXPECT_EQ(diagnostics.counted(on_base), 0) << "the robot's odometry publishes it";

  settings_.odom_from_tf = false, settings_.base_frame = "static_base";
  start();
  EXPECT_TRUE(diagnostics.await("/rival publishes 'mast' -> 'static_base' on tf", 1));

  settings_.publish_tf = false;
  start();
  EXPECT_TRUE(diagnostics.refresh() && diagnostics.refresh());
  EXPECT_EQ(diagnostics.counted("/rival publishes"), 0);
}

// As image_transport's compressed records depth where it was told to take PNG.
TEST_F(Shell, DepthMayBeCompressedAsAnyImage) {
  const ros::Publisher depth = handle_.advertise<sensor_msgs::CompressedImage>("depth/compressed", 100);
  settings_.use_imu = false;
  start("depth/compressed");
  sensor_msgs::CompressedImage msg;
  msg.format = "16UC1; png compressed ";
  cv::imencode(".png", cv::Mat(6, 8, CV_16UC1, cv::Scalar(1500)), msg.data);
  EXPECT_TRUE(publishUntil([&] {
    msg.header.stamp = ros::Time(100 + 0.1 * next_);
    depth.publish(msg);
    return estimator_.depths > 3;
  }));
}

TEST_F(Shell, TwoStreamsOfAnImuStayOneSequenceWhateverTheThreads) {
  ros::AsyncSpinner spinner(4);
  spinner.start();
  std::atomic<bool> over{false};
  std::atomic<int> answered{0};
  std::thread user([&] {
    while (!over) {
      std_srvs::Trigger reset;
      answered += ros::service::call(ros::this_node::getName() + "/reset", reset);
      air_ground::SaveTrajectory save;
      save.request.path = "/nowhere/at/all.txt";
      answered += ros::service::call(ros::this_node::getName() + "/save_trajectory", save);
      ros::WallDuration(0.05).sleep();
    }
  });
  for (int i = 0; i < 300 || (estimator_.samples < 1000 && i < 6000); ++i) {
    publish(next_++);
    ros::WallDuration(0.005).sleep();
  }
  over = true;
  user.join();
  spinner.stop();
  shell_->stop();
  EXPECT_GT(answered, 2);
  EXPECT_GT(estimator_.samples, 500);
  EXPECT_EQ(estimator_.disorder, 0);
}

}  // namespace
}  // namespace air_ground_common::ros_utils

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "estimator_shell_test");
  const ros::NodeHandle keep_alive;
  if (argc > 1 && std::string(argv[1]) == "--rival") {
    air_ground_common::ros_utils::beRival();
    return 0;
  }
  return RUN_ALL_TESTS();
}
