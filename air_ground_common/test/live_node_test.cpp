// What a node meets in the field: a supervisor that ends it, clocks of two machines. Started by live_node.test.
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/health.h"
#include "air_ground_common/ros/node_testing.h"
#include "air_ground_common/ros/parameters.h"
#include "console.h"

namespace air_ground_common::ros_utils {
namespace {

// ---- A node that leaves a file when it is stopped -------------------------------------------------------------------

struct SaverSettings {
  std::string autosave;
  void validate() const {}
};

void describe(ParameterVisitor& v, SaverSettings& s) { v("autosave", s.autosave, "folder"); }

class Saver {
 public:
  explicit Saver(const SaverSettings& settings) : autosave_(settings.autosave) { ros::param::set("saver_runs", true); }
  ~Saver() {
    autosave_.save("map.ply", [](const std::string& path) { std::ofstream(path) << "all of it"; });
    autosave_.save("trajectory.txt", [](const std::string&) { throw std::runtime_error("there is none yet"); });
  }

 private:
  const Autosave autosave_;
};

std::string contents(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST(RunNode, ATerminatedNodeSavesAndSaysSo) {
  namespace fs = std::filesystem;
  const std::string folder = testing::TempDir() + "terminated_node_" + std::to_string(getpid()),
                    said = folder + "/said";
  fs::create_directories(folder);
  ros::param::del("saver_runs");
  const std::string program = fs::read_symlink("/proc/self/exe"), autosave = "_autosave:=" + folder + "/maps";
  const pid_t node = fork();
  if (node == 0) {
    if (freopen(said.c_str(), "w", stderr) == nullptr) _exit(1);
    execl(program.c_str(), program.c_str(), "--saver", "__name:=saver", autosave.c_str(), nullptr);
    _exit(1);
  }
  ASSERT_GT(node, 0);
  EXPECT_TRUE(spinUntil([] { return ros::param::has("saver_runs"); }));
  pause(20);  // it begins to spin
  kill(node, SIGTERM);
  int status = 0;
  ASSERT_EQ(waitpid(node, &status, 0), node);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << "ended by signal " << WTERMSIG(status);
  ASSERT_EQ(std::distance(fs::directory_iterator(folder + "/maps"), {}), 1);
  const std::string saved = fs::directory_iterator(folder + "/maps")->path();
  EXPECT_EQ(contents(saved), "all of it");
  EXPECT_NE(contents(said).find("saved " + saved + "\n"), std::string::npos) << contents(said);
  EXPECT_NE(contents(said).find("_trajectory.txt: there is none yet\n"), std::string::npos) << contents(said);
  fs::remove_all(folder);
}

// ---- Clocks ---------------------------------------------------------------------------------------------------------

TEST(NodeHealth, SaysThatClocksDiffer) {
  const Console console;
  NodeHealth health("clocks_test");
  NodeDiagnostics diagnostics(ros::this_node::getName().substr(1));
  const auto says = [&](const std::string& line) { return diagnostics.message().find(line) != std::string::npos; };
  health.state(health.kOk, "tracking");
  health.expectInput("/behind");
  health.expectInput("/ahead");
  health.expectInput("/near");
  health.expectInput("/map", false);  // latched: as old as it is
  const auto receive = [&](double wrong) {
    const ros::Time now = ros::Time::now();
    health.received("/behind", now - ros::Duration(57 * wrong));
    health.received("/ahead", now + ros::Duration(8 * wrong));
    health.received("/near", now - ros::Duration(4));
    health.received("/map", now - ros::Duration(57));
  };
  EXPECT_TRUE(spinUntil([&] {
    receive(1);
    return console.count("/behind is stamped 57 s behind this machine's clock: synchronise the clocks") > 0 &&
           console.count("/ahead is stamped 8 s ahead of this machine's clock: ") > 0 &&
           says("tracking; /ahead is stamped 8 s ahead of this machine's clock; /behind is stamped 57 s behind");
  }));
  EXPECT_EQ(diagnostics.level(), diagnostic_msgs::DiagnosticStatus::WARN);
  spinUntil(
      [&] {
        receive(1);
        return false;
      },
      400);
  EXPECT_EQ(console.count("/behind is stamped"), 1) << "once a minute";
  EXPECT_EQ(console.count("/near is stamped") + console.count("/map is stamped"), 0);
  EXPECT_TRUE(spinUntil([&] {
    receive(0);
    return diagnostics.message() == "tracking";
  }));
  EXPECT_EQ(diagnostics.level(), diagnostic_msgs::DiagnosticStatus::OK);
}

TEST(NodeHealth, FewStampsThatAreOffAreNoClock) {
  const Console console;
  NodeHealth health("few_test");
  health.expectInput("/now_and_then");
  health.expectInput("/not_set");
  for (int i = 0; i < 100; ++i) {
    const ros::Time now = ros::Time::now();
    health.received("/now_and_then", i % 5 == 0 ? now : now - ros::Duration(60));
    health.received("/not_set", ros::Time());
    pause(4);
  }
  EXPECT_EQ(console.count("/now_and_then is stamped") + console.count("/not_set is stamped"), 0);
}

TEST(NodeHealth, AReplayHasAClockOfItsOwn) {
  ros::Time::setNow(ros::Time(1000));
  const Console console;
  NodeHealth health("replay_test");
  health.expectInput("/of_a_bag");
  for (int i = 0; i < 100; ++i) {
    ros::Time::setNow(ros::Time(1000 + 0.05 * i));
    health.received("/of_a_bag", ros::Time(900 + 0.05 * i));
    pause(4);
  }
  EXPECT_EQ(console.count("/of_a_bag is stamped"), 0);
  ros::Time::init();
}

}  // namespace
}  // namespace air_ground_common::ros_utils

int main(int argc, char** argv) {
  using namespace air_ground_common::ros_utils;
  if (argc > 1 && std::string(argv[1]) == "--saver") return runNode<SaverSettings, Saver>(argc, argv, "saver");
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "live_node_test");
  const ros::NodeHandle keep_alive;
  return RUN_ALL_TESTS();
}
