// A node goes on when the master is gone, and is known to the next one. Runs masters of its own, and kills the first.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <ros/ros.h>
#include <std_msgs/Empty.h>
#include <std_srvs/Trigger.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/ros/renewable_subscriber.h"

namespace air_ground_common::ros_utils {
namespace {

/// A program that runs as long as this lives.
class Child {
 public:
  explicit Child(const std::vector<std::string>& words) : pid_(fork()) {
    if (pid_ != 0) return;
    std::vector<char*> arguments;
    for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    execvp(arguments[0], arguments.data());
    _exit(1);
  }
  ~Child() {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

 private:
  pid_t pid_;
};

/// Below those that the system hands out, and not another process's. 0: there is none.
int freePort() {
  constexpr int kFirst = 20000, kPorts = 10000;
  for (int i = 0; i < kPorts; ++i) {
    const int port = kFirst + (getpid() + i) % kPorts, listener = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const bool is_free = bind(listener, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0;
    close(listener);
    if (is_free) return port;
  }
  return 0;
}

struct Master : Child {
  explicit Master(const std::string& port) : Child({"rosmaster", "--core", "-p", port}) {}
};

/// At the master's port, and none: of the topics that are published it gives no list.
struct OtherServer : Child {
  explicit OtherServer(const std::string& port)
      : Child({"/usr/bin/python3", "-c",
               "from xmlrpc.server import SimpleXMLRPCServer as Server\n"
               "server = Server(('localhost', " +
                   port +
                   "), logRequests=False)\n"
                   "server.register_function(lambda *_: [1, '', 7], 'getPid')\n"
                   "server.register_function(lambda *_: [1, '', [7]], 'getPublishedTopics')\n"
                   "server.register_function(lambda *_: [1, '', []], 'registerSubscriber')\n"
                   "server.serve_forever()"}) {}
};

void ignore(const std_msgs::Empty::ConstPtr&) {}

/// What the master has of this node: "publisher /topic", "service /name" and so on.
std::set<std::string> registered() {
  XmlRpc::XmlRpcValue request, response, state;
  request[0] = "/test";
  std::set<std::string> result;
  if (!ros::master::execute("getSystemState", request, response, state, false)) return result;
  const char* kinds[] = {"publisher ", "subscriber ", "service "};
  for (int kind = 0; kind < 3; ++kind)
    for (int i = 0; i < state[kind].size(); ++i)
      for (int k = 0; k < state[kind][i][1].size(); ++k)
        if (std::string(state[kind][i][1][k]) == ros::this_node::getName())
          result.insert(kinds[kind] + std::string(state[kind][i][0]));
  return result;
}

bool answer(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
  response.success = true;
  return true;
}

TEST(NodeHealth, GoesOnWithoutMasterAndRegistersWithANewOne) {
  const std::string port = std::to_string(freePort());
  ASSERT_NE(port, "0");
  setenv("ROS_MASTER_URI", ("http://localhost:" + port).c_str(), 1);
  std::optional<Master> master(std::in_place, port);
  int argc = 0;
  ros::init(argc, nullptr, "master_lost_test", ros::init_options::NoSigintHandler);
  const auto masterIsThere = [] {
    for (int i = 0; i < 600 && !ros::master::check(); ++i) ros::WallDuration(0.1).sleep();
    return ros::master::check();
  };
  ASSERT_TRUE(masterIsThere()) << "no master on port " << port;
  ros::param::set("~nested/number", 7);
  const ros::NodeHandle keep_alive;
  NodeHealth health("master_lost_test");
  NodeDiagnostics diagnostics("master_lost_test");
  RenewableSubscriber latched([] { return ros::NodeHandle().subscribe("latched", 1, ignore); });
  int heard = 0;
  const ros::Subscriber topic = ros::NodeHandle().subscribe<std_msgs::Empty>(
      "from_another_process", 1, [&](const std_msgs::Empty::ConstPtr&) { ++heard; });
  const ros::ServiceServer service = ros::NodeHandle("~").advertiseService("trigger", answer);
  ASSERT_TRUE(diagnostics.refresh());
  pause(1400);  // it looks every five seconds
  const std::set<std::string> before = registered();
  EXPECT_EQ(before.count("publisher /diagnostics"), 1u);
  EXPECT_EQ(before.count("subscriber /latched"), 1u);
  EXPECT_EQ(before.count("service /master_lost_test/trigger"), 1u);
  health.expectInput("/silent", true, "/silent/compressed", "nothing");
  master.reset();
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

  {
    const OtherServer other(port);
    ASSERT_TRUE(masterIsThere());
    health.expectInput("/silent/too");
    pause(1000);  // 3 s of silence, and what is asked then
    EXPECT_TRUE(diagnostics.refresh()) << "an answer that is none ends nothing";
  }
  master.emplace(port);
  ASSERT_TRUE(masterIsThere());
  const Child other({"rostopic", "pub", "-r", "10", "/from_another_process", "std_msgs/Empty"});
  EXPECT_TRUE(spinUntil([&] { return registered() == before; }));
  EXPECT_EQ(registered(), before);
  int number = 0;
  EXPECT_TRUE(ros::param::get("~nested/number", number));
  EXPECT_EQ(number, 7);
  EXPECT_TRUE(spinUntil([&] { return heard > 3; })) << "a publisher that began with the new master is not heard";
}

}  // namespace
}  // namespace air_ground_common::ros_utils

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
