#include "node_parameters.h"

#include <yaml-cpp/yaml.h>

#include "air_ground_common/ros/parameters.h"
#include "refiner_parameters.h"

namespace icp_refine {
namespace {

YAML::Node toYaml(XmlRpc::XmlRpcValue& value) {
  switch (value.getType()) {
    case XmlRpc::XmlRpcValue::TypeBoolean:
      return YAML::Node(static_cast<bool>(value));
    case XmlRpc::XmlRpcValue::TypeInt:
      return YAML::Node(static_cast<int>(value));
    case XmlRpc::XmlRpcValue::TypeDouble:
      return YAML::Node(static_cast<double>(value));
    case XmlRpc::XmlRpcValue::TypeString:
      return YAML::Node(static_cast<std::string>(value));
    case XmlRpc::XmlRpcValue::TypeArray: {
      YAML::Node out(YAML::NodeType::Sequence);
      for (int i = 0; i < value.size(); ++i) out.push_back(toYaml(value[i]));
      return out;
    }
    case XmlRpc::XmlRpcValue::TypeStruct: {
      YAML::Node out(YAML::NodeType::Map);
      for (auto& item : value) out[item.first] = toYaml(item.second);
      return out;
    }
    default:
      throw ConfigError("the parameter `chain` holds a value of a type that no stage takes");
  }
}

}  // namespace

NodeSettings readParameters(const ros::NodeHandle& private_handle) {
  air_ground_common::ros_utils::Parameters p(private_handle);
  NodeSettings s;
  s.ground_map_frame = p.text("ground_map_frame", "ground_map");
  s.mav_map_frame = p.text("mav_map_frame", "mav_map");
  s.visual_map_frame = p.text("visual_map_frame", "mav_visual_map");
  s.publish_tf = p.flag("publish_tf", s.publish_tf);
  s.inverse_tf = p.flag("inverse_tf", s.inverse_tf);
  s.tf_rate = p.number("tf_rate", s.tf_rate, 0.1, 1000);
  s.queue_size = p.integer("queue_size", s.queue_size, 1, 10000);
  s.min_period = p.number("min_period", s.min_period, 0, 3600);
  s.map.leaf = p.number("augmented_map/leaf", s.map.leaf, 0.001, 10);
  s.map_period = p.number("augmented_map/period", s.map_period, 0, 3600);
  s.map.min_points = p.integer("augmented_map/min_points", s.map.min_points, 1, 1000000);
  s.map.max_voxels = static_cast<std::size_t>(
      p.integer("augmented_map/max_points", static_cast<int>(s.map.max_voxels), 1000, 100000000));
  s.map.fill_only = p.flag("augmented_map/fill_only", s.map.fill_only);
  s.map.ground_red = p.choice("augmented_map/ground_color", "red", {"red", "original"}) == "red";
  s.chain_file = p.text("chain_file", "");
  s.refiner = readRefinerSettings(p);
  p.finish({"chain/"});
  return s;
}

IcpChain readChain(const ros::NodeHandle& private_handle, const std::string& file) {
  if (!file.empty()) return IcpChain::fromFile(file);
  XmlRpc::XmlRpcValue value;
  if (!private_handle.getParam("chain", value)) {
    throw ConfigError("parameter " + private_handle.resolveName("chain") +
                      " is missing: load config/icp_refine.yaml, or set chain_file");
  }
  return IcpChain(toYaml(value));
}

}  // namespace icp_refine
