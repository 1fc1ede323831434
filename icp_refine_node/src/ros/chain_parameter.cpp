#include "chain_parameter.h"

#include <yaml-cpp/yaml.h>

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
