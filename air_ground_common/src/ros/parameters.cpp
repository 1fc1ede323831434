#include "air_ground_common/ros/parameters.h"

#include <ros/param.h>

#include <csignal>

namespace air_ground_common::ros_utils {

ServerReader::ServerReader(const ros::NodeHandle& private_handle) : handle_(private_handle) {
  others(kStartsParameter);
  double period = 1;  // diagnostic_updater reads it by itself, and takes any
  (*this)("diagnostic_period", period, {0.01, 3600}, "s", "");
}

void ServerReader::visit(const Parameter& p, ParameterField field) {
  known_.insert(p.name);
  const std::string full = handle_.resolveName(p.name), preset = toString(field);
  if (handle_.hasParam(p.name) && !std::visit([&](auto* value) { return handle_.getParam(p.name, *value); }, field)) {
    XmlRpc::XmlRpcValue raw;
    handle_.getParam(p.name, raw);
    throw ParameterError("parameter " + full + " = " + raw.toXml() + " has the wrong type; expected something like " +
                         preset);
  }
  const std::string value = toString(field);
  if (value == preset)
    ROS_DEBUG_STREAM("parameter " << full << ": " << value);
  else
    ROS_INFO_STREAM("parameter " << full << ": " << value << " in place of " << preset);
}

void ServerReader::finish() const {
  std::vector<std::string> names;
  ros::param::getParamNames(names);
  const std::string prefix = handle_.getNamespace() + "/";
  for (const auto& full : names) {
    if (full.compare(0, prefix.size(), prefix) == 0 && !isKnown(full.substr(prefix.size())))
      throw ParameterError("parameter " + full +
                           " is not one of this node's; see its file in config/ for the names it reads. If no file of "
                           "yours sets it any more, it is left on the master from an earlier launch: rosparam delete " +
                           full);
  }
}

void endOnSigterm() {
  std::signal(SIGTERM, [](int) { ros::requestShutdown(); });  // sets a flag, as roscpp's own handler of SIGINT does
}

}  // namespace air_ground_common::ros_utils
