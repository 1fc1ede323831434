// Parameters of a node, from the ROS parameter server: read once, checked, echoed. A bad or misspelt one ends it at
// start.
#pragma once

#include <ros/console.h>
#include <ros/init.h>
#include <ros/node_handle.h>

#include <cstdio>
#include <string>

#include "air_ground_common/niceness.h"
#include "air_ground_common/parameters.h"

namespace air_ground_common::ros_utils {

/// Private parameter that counts how often a node has been started under this master; kept by the nodes themselves.
constexpr const char* kStartsParameter = "starts";

/// Meaning of the parameter player_waits.
constexpr const char* kPlayerWaits =
    "true: of a replay whose player is held while this node lags (set by replay.launch and city.launch): no image is "
    "dropped for being late";

/// Reads the private parameters of a node. Throws ParameterError.
class ServerReader : public ParameterReader {
 public:
  explicit ServerReader(const ros::NodeHandle& private_handle);

  /// Call after describe: throws for a private parameter that nobody read (a misspelt name).
  void finish() const;

 private:
  void visit(const Parameter& parameter, ParameterField field) override;
  std::string fullName(const std::string& name) const override { return handle_.resolveName(name); }

  ros::NodeHandle handle_;
};

/// Settings with `describe` and, for what concerns several of them, `validate`.
template <typename Settings>
Settings readParameters(const ros::NodeHandle& private_handle) {
  Settings settings;
  ServerReader reader(private_handle);
  describe(reader, settings);
  reader.finish();
  settings.validate();
  return settings;
}

/// Of settings that have a `niceness`; else 0.
template <typename Settings>
auto nicenessOf(const Settings& settings, int) -> decltype(settings.niceness) {
  return settings.niceness;
}
template <typename Settings>
int nicenessOf(const Settings&, long) {
  return 0;
}

/// SIGTERM, as systemd and other supervisors send it, ends the node as SIGINT does: what it has is saved.
void endOnSigterm();

/// The main program of a node: `run(settings)` makes it and spins, with the niceness of its settings. With
/// --parameters, prints its parameter file instead.
template <typename Settings, typename Run>
int runNode(int argc, char** argv, const std::string& name, const Run& run) {
  if (argc == 2 && std::string(argv[1]) == "--parameters") return std::fputs(yamlFile(Settings()).c_str(), stdout) < 0;
  ros::init(argc, argv, name);
  const ros::NodeHandle keep_alive;  // with the last handle roscpp ends, and the console with it
  endOnSigterm();
  try {
    const auto settings = readParameters<Settings>(ros::NodeHandle("~"));
    giveWay(nicenessOf(settings, 0));
    run(settings);
  } catch (const std::exception& e) {
    ROS_FATAL_STREAM(name << ": " << e.what());
    return 1;
  }
  return 0;
}

/// The same of a node that is made from its settings and needs one thread.
template <typename Settings, typename Node>
int runNode(int argc, char** argv, const std::string& name) {
  return runNode<Settings>(argc, argv, name, [](const Settings& settings) {
    Node node(settings);
    ros::spin();
  });
}

}  // namespace air_ground_common::ros_utils
