// The configuration file says what the node does without it; odometry is kept within bounds whatever its stamps.
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <map>
#include <string>
#include <variant>
#include <vector>

#include "../src/odometry_buffer.h"
#include "../src/streetview_localizer_parameters.h"

namespace streetview_localizer {
namespace {

// Answers every parameter with its default, and keeps that.
struct Defaults {
  std::map<std::string, std::variant<double, int, bool, std::string>> values;

  template <typename T>
  T keep(const std::string& name, const T& fallback) {
    values[name] = fallback;
    return fallback;
  }
  double number(const std::string& name, double fallback, double min, double max) {
    EXPECT_TRUE(fallback >= min && fallback <= max) << name;
    return keep(name, fallback);
  }
  int integer(const std::string& name, int fallback, int min, int max) {
    EXPECT_TRUE(fallback >= min && fallback <= max) << name;
    return keep(name, fallback);
  }
  bool flag(const std::string& name, bool fallback) { return keep(name, fallback); }
  std::string text(const std::string& name, const std::string& fallback) { return keep(name, fallback); }
  std::string choice(const std::string& name, const std::string& fallback, const std::vector<std::string>&) {
    return keep(name, fallback);
  }
};

void compare(const std::string& name, const YAML::Node& value, Defaults* defaults) {
  if (value.IsMap()) {
    for (const auto& entry : value)
      compare((name.empty() ? "" : name + "/") + entry.first.as<std::string>(), entry.second, defaults);
    return;
  }
  const auto it = defaults->values.find(name);
  ASSERT_NE(it, defaults->values.end()) << name << " is not a parameter of the node";
  if (const auto* number = std::get_if<double>(&it->second)) {
    // Angles are radians inside and degrees, to two or three digits, in the file.
    EXPECT_NEAR(value.as<double>(), *number, 0.005 * std::abs(*number)) << name;
  } else if (const auto* integer = std::get_if<int>(&it->second)) {
    EXPECT_EQ(value.as<int>(), *integer) << name;
  } else if (const auto* flag = std::get_if<bool>(&it->second)) {
    EXPECT_EQ(value.as<bool>(), *flag) << name;
  } else if (name != "index" || isAvailable(IndexMethod::kHnsw)) {
    EXPECT_EQ(value.as<std::string>(), std::get<std::string>(it->second)) << name;
  }
  defaults->values.erase(it);
}

TEST(Configuration, FileHoldsTheDefaults) {
  Defaults defaults;
  readSettings(defaults);
  compare("", YAML::LoadFile(AIR_GROUND_SOURCE_DIR "/config/streetview_localizer.yaml"), &defaults);
  defaults.values.erase("database");  // an argument of the launch file
  for (const auto& [name, value] : defaults.values)
    ADD_FAILURE() << name << " is missing in config/streetview_localizer.yaml";
}

TimedPose at(double stamp) {
  TimedPose pose;
  pose.stamp = stamp;
  return pose;
}

TEST(OdometryBuffer, KeepsTenSecondsAndFindsTheNearest) {
  OdometryBuffer buffer;
  for (int i = 0; i <= 3000; ++i) buffer.push(at(100 + 0.01 * i));
  EXPECT_LE(buffer.size(), 1002u);
  EXPECT_TRUE(buffer.reaches(130));
  EXPECT_FALSE(buffer.reaches(130.5));
  ASSERT_TRUE(buffer.nearest(125.004, 0.1));
  EXPECT_NEAR(buffer.nearest(125.004, 0.1)->stamp, 125, 1e-6);
  EXPECT_FALSE(buffer.nearest(131, 0.5));
}

TEST(OdometryBuffer, DoesNotGrowAfterAStampFarAhead) {
  OdometryBuffer buffer;
  buffer.push(at(100));
  buffer.push(at(4e9));
  for (int i = 0; i < 3000; ++i) buffer.push(at(100 + 0.01 * i));
  EXPECT_LE(buffer.size(), 1002u);
  for (int i = 0; i < 30000; ++i) buffer.push(at(140));
  EXPECT_LE(buffer.size(), OdometryBuffer::kMost);
  buffer.push(at(5));  // a looped bag
  EXPECT_EQ(buffer.size(), 1u);
}

}  // namespace
}  // namespace streetview_localizer
