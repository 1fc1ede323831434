#include "air_ground_common/ros/parameters.h"

#include <ros/console.h>
#include <ros/param.h>

#include <algorithm>
#include <cmath>
#include <sstream>

namespace air_ground_common::ros_utils {
namespace {

template <typename T>
std::string printed(const T& value) {
  std::ostringstream s;
  s << std::boolalpha << value;
  return s.str();
}

std::string printed(const std::vector<double>& values) {
  std::ostringstream s;
  s << '[';
  for (std::size_t i = 0; i < values.size(); ++i) s << (i ? ", " : "") << values[i];
  s << ']';
  return s.str();
}

template <typename T>
void checkRange(const std::string& name, T value, T min, T max) {
  if (value >= min && value <= max) return;
  throw ParameterError("parameter " + name + " = " + printed(value) + " is outside its range [" + printed(min) + ", " +
                       printed(max) + "]");
}

}  // namespace

Parameters::Parameters(const ros::NodeHandle& private_handle) : handle_(private_handle) {}

template <typename T>
T Parameters::get(const std::string& name, const T& fallback) {
  read_.insert(name);
  T value = fallback;
  const std::string full = handle_.resolveName(name);
  if (handle_.hasParam(name) && !handle_.getParam(name, value)) {
    XmlRpc::XmlRpcValue raw;
    handle_.getParam(name, raw);
    throw ParameterError("parameter " + full + " = " + raw.toXml() + " has the wrong type; expected something like " +
                         printed(fallback));
  }
  ROS_INFO_STREAM("parameter " << full << ": " << printed(value));
  return value;
}

double Parameters::number(const std::string& name, double fallback, double min, double max) {
  const double value = get<double>(name, fallback);
  checkRange(handle_.resolveName(name), value, min, max);
  return value;
}

int Parameters::integer(const std::string& name, int fallback, int min, int max) {
  const int value = get<int>(name, fallback);
  checkRange(handle_.resolveName(name), value, min, max);
  return value;
}

bool Parameters::flag(const std::string& name, bool fallback) { return get<bool>(name, fallback); }

std::string Parameters::text(const std::string& name, const std::string& fallback) {
  return get<std::string>(name, fallback);
}

std::string Parameters::choice(const std::string& name, const std::string& fallback,
                               const std::vector<std::string>& allowed) {
  const std::string value = get<std::string>(name, fallback);
  std::string list;
  for (const auto& a : allowed) {
    if (a == value) return value;
    list += (list.empty() ? "" : ", ") + a;
  }
  throw ParameterError("parameter " + handle_.resolveName(name) + " = '" + value + "' must be one of: " + list);
}

std::vector<double> Parameters::numbers(const std::string& name, const std::vector<double>& fallback,
                                        std::size_t size) {
  const auto value = get<std::vector<double>>(name, fallback);
  bool finite = value.size() == size;
  for (const double v : value) finite = finite && std::isfinite(v);
  if (!finite)
    throw ParameterError("parameter " + handle_.resolveName(name) + " = " + printed(value) + " must hold " +
                         std::to_string(size) + " finite numbers");
  return value;
}

std::optional<Pose> Parameters::pose(const std::string& name) {
  const auto v = numbers(name, std::vector<double>(7, 0.0), 7);
  if (std::all_of(v.begin(), v.end(), [](double x) { return x == 0; })) return std::nullopt;
  const Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  if (std::abs(q.norm() - 1) > 1e-2)
    throw ParameterError("parameter " + handle_.resolveName(name) + " = " + printed(v) +
                         ": the quaternion (last four numbers) must have length 1");
  Pose T = Pose::Identity();
  T.linear() = q.normalized().toRotationMatrix();
  T.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  return T;
}

void Parameters::finish(const std::set<std::string>& ignored) const {
  std::vector<std::string> names;
  ros::param::getParamNames(names);
  const std::string prefix = handle_.getNamespace() + "/";
  for (const auto& full : names) {
    if (full.compare(0, prefix.size(), prefix) != 0) continue;
    const std::string name = full.substr(prefix.size());
    bool known = read_.count(name) > 0 || name == kStartsParameter;
    // A map or list read whole covers what lies below it.
    for (auto slash = name.find('/'); !known && slash != std::string::npos; slash = name.find('/', slash + 1))
      known = read_.count(name.substr(0, slash)) > 0 || ignored.count(name.substr(0, slash + 1)) > 0;
    if (!known && !ignored.count(name))
      throw ParameterError("parameter " + full +
                           " is not one of this node's; see its file in config/ for the names it reads");
  }
}

}  // namespace air_ground_common::ros_utils
