// Parameters that are read once, checked against their range, and echoed. A bad or misspelt one ends the node at start.
#pragma once

#include <ros/node_handle.h>

#include <optional>
#include <set>
#include <string>
#include <vector>

#include "air_ground_common/geometry.h"

namespace air_ground_common::ros_utils {

/// Thrown with one line that names the parameter, its value and what is allowed.
class ParameterError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Private parameter that counts how often a node has been started under this master; kept by the nodes themselves.
constexpr const char* kStartsParameter = "starts";

/// Reads private parameters of a node. Every getter throws ParameterError.
class Parameters {
 public:
  explicit Parameters(const ros::NodeHandle& private_handle);

  double number(const std::string& name, double fallback, double min, double max);
  int integer(const std::string& name, int fallback, int min, int max);
  bool flag(const std::string& name, bool fallback);
  std::string text(const std::string& name, const std::string& fallback);
  /// `allowed` lists the accepted values.
  std::string choice(const std::string& name, const std::string& fallback, const std::vector<std::string>& allowed);
  std::vector<double> numbers(const std::string& name, const std::vector<double>& fallback, std::size_t size);
  /// "x y z qx qy qz qw" [m]; seven zeros, the default, for "not given".
  std::optional<Pose> pose(const std::string& name);

  /// Call after the last getter: throws for a private parameter that nobody read (a misspelt name). `ignored` lists
  /// names, or prefixes ending in '/', that others own.
  void finish(const std::set<std::string>& ignored = {}) const;

 private:
  template <typename T>
  T get(const std::string& name, const T& fallback);

  ros::NodeHandle handle_;
  std::set<std::string> read_;
};

}  // namespace air_ground_common::ros_utils
