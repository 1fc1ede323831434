// What every stage of the chain shares: parameters declared with doc, default, minimum and maximum; and the registry by
// name.
#pragma once

#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace YAML {
class Node;
}

namespace icp_refine {

/// A chain that cannot be built: the message names the stage and the parameter.
class ConfigError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

struct ParameterDoc {
  std::string name;
  std::string doc;  ///< meaning, with the unit in brackets
  double default_value;
  double min, max;  ///< inclusive
};
using ParameterDocs = std::vector<ParameterDoc>;

struct StageDoc {
  std::string name;
  std::string doc;
  ParameterDocs parameters;
};

/// A stage's numbers, checked against its declaration.
class StageParameters {
 public:
  /// `node`: a map of numbers (or booleans), or null for all defaults.
  /// Throws ConfigError for a name that was not declared, a value that is no number, or one out of range.
  StageParameters(const StageDoc& stage, const YAML::Node& node);

  /// Throws std::logic_error for a name that was not declared.
  double operator()(const std::string& name) const;

 private:
  std::string stage_;
  std::map<std::string, double> values_;
};

}  // namespace icp_refine
