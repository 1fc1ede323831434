#include "icp_refine/stage.h"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <sstream>

namespace icp_refine {

StageParameters::StageParameters(const StageDoc& stage, const YAML::Node& node) : stage_(stage.name) {
  std::string known;
  for (const auto& p : stage.parameters) {
    values_[p.name] = p.default_value;
    known += (known.empty() ? "" : ", ") + p.name;
  }
  if (!node || node.IsNull()) return;
  if (!node.IsMap()) throw ConfigError(stage.name + ": its parameters must be a map 'name: number'");
  for (const auto& item : node) {
    const auto name = item.first.as<std::string>();
    const ParameterDoc* doc = nullptr;
    for (const auto& p : stage.parameters) {
      if (p.name == name) doc = &p;
    }
    if (!doc) throw ConfigError(stage.name + ": unused parameter '" + name + "'; it has: " + known);
    double value = 0;
    bool flag = false;
    if (item.second.IsScalar() && YAML::convert<double>::decode(item.second, value)) {
    } else if (item.second.IsScalar() && YAML::convert<bool>::decode(item.second, flag)) {
      value = flag;
    } else {
      throw ConfigError(stage.name + ": parameter '" + name + "' must be a number");
    }
    if (!(value >= doc->min && value <= doc->max)) {
      std::ostringstream message;
      message << stage.name << ": parameter '" << name << "' is " << value << ", outside [" << doc->min << ", "
              << doc->max << "]";
      throw ConfigError(message.str());
    }
    values_[name] = value;
  }
}

double StageParameters::operator()(const std::string& name) const {
  const auto it = values_.find(name);
  if (it == values_.end()) throw std::logic_error(stage_ + " reads the undeclared parameter " + name);
  return it->second;
}

}  // namespace icp_refine
