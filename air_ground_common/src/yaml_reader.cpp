#include <yaml-cpp/yaml.h>

#include "air_ground_common/parameters.h"

namespace air_ground_common {
namespace {

void flatten(const YAML::Node& node, const std::string& name, std::map<std::string, std::string>* given) {
  if (node.IsMap()) {
    for (const auto& entry : node)
      flatten(entry.second, (name.empty() ? "" : name + "/") + entry.first.as<std::string>(), given);
  } else {
    (*given)[name] = YAML::Dump(node);
  }
}

}  // namespace

YamlReader::YamlReader(const std::string& path, const std::vector<std::string>& assignments) {
  try {
    if (!path.empty()) flatten(YAML::LoadFile(path), "", &given_);
  } catch (const YAML::Exception& e) {
    throw ParameterError(path + ": " + e.what());
  }
  for (const std::string& text : assignments) {
    const auto equals = text.find('=');
    if (equals == std::string::npos) throw ParameterError("'" + text + "' is not NAME=VALUE");
    given_[text.substr(0, equals)] = text.substr(equals + 1);
  }
}

void YamlReader::visit(const Parameter& p, ParameterField field) {
  known_.insert(p.name);
  const auto it = given_.find(p.name);
  if (it == given_.end()) return;
  try {
    std::visit([&](auto* value) { *value = YAML::Load(it->second).as<std::remove_pointer_t<decltype(value)>>(); },
               field);
  } catch (const YAML::Exception&) {
    throw ParameterError("parameter " + p.name + " = " + it->second + " has the wrong type; expected something like " +
                         toString(field));
  }
}

void YamlReader::finish() const {
  for (const auto& [name, value] : given_)
    if (!isKnown(name)) throw ParameterError("parameter " + name + " = " + value + " is none of this program's");
}

}  // namespace air_ground_common
