// The callbacks of a node go on when the master is gone. Runs a master of its own and kills it.
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <std_msgs/Empty.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <string>

#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/ros/renewable_subscriber.h"

namespace air_ground_common::ros_utils {
namespace {

class Master {
 public:
  explicit Master(const std::string& port) : pid_(fork()) {
    if (pid_ != 0) return;
    execlp("rosmaster", "rosmaster", "--core", "-p", port.c_str(), static_cast<char*>(nullptr));
    _exit(1);
  }
  ~Master() { stop(); }
  void stop() {
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }

 private:
  pid_t pid_;
};

void ignore(const std_msgs::Empty::ConstPtr&) {}

TEST(NodeHealth, CallbacksGoOnWithoutMaster) {
  const std::string port = std::to_string(20000 + getpid() % 10000);
  setenv("ROS_MASTER_URI", ("http://localhost:" + port).c_str(), 1);
  Master master(port);
  int argc = 0;
  ros::init(argc, nullptr, "master_lost_test", ros::init_options::NoSigintHandler);
  for (int i = 0; i < 600 && !ros::master::check(); ++i) ros::WallDuration(0.1).sleep();
  ASSERT_TRUE(ros::master::check()) << "no master on port " << port;
  const ros::NodeHandle keep_alive;
  NodeHealth health("master_lost_test");
  NodeDiagnostics diagnostics("master_lost_test");
  RenewableSubscriber latched([] { return ros::NodeHandle().subscribe("latched", 1, ignore); });
  ASSERT_TRUE(diagnostics.refresh());
  health.expectInput("/silent", true, "/silent/compressed", "nothing");
  master.stop();
  latched.renew();
  // 3 s of silence, and what is asked of the master then.
  ros::WallTime last = ros::WallTime::now(), end = last + ros::WallDuration(8);
  double longest = 0;
  while (ros::WallTime::now() < end) {
    ros::spinOnce();
    const ros::WallTime now = ros::WallTime::now();
    longest = std::max(longest, (now - last).toSec());
    last = now;
    ros::WallDuration(0.01).sleep();
  }
  EXPECT_LT(longest, 2.0) << "a callback waited for the master";
  EXPECT_TRUE(diagnostics.refresh()) << "diagnostics go on";
  EXPECT_NE(diagnostics.level(), -1);
}

}  // namespace
}  // namespace air_ground_common::ros_utils

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
