#include "air_ground_common/ros/mountings.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "air_ground_common/ros/sensor_input.h"
#include "air_ground_common/text.h"
#include "air_ground_common/units.h"

namespace air_ground_common::ros_utils {
namespace {

std::string listed(std::vector<std::string> names) {
  constexpr std::size_t kMost = 20;
  std::sort(names.begin(), names.end());
  std::string list;
  for (std::size_t i = 0; i < std::min(names.size(), kMost); ++i) list += (i ? ", '" : "'") + names[i] + "'";
  return names.size() > kMost ? list + " and " + std::to_string(names.size() - kMost) + " more" : list;
}

}  // namespace

Mountings::Mountings(const std::string& base_frame, TransformBuffer::Listener listener)
    : base_frame_(withoutSlash(base_frame)), transforms_(std::move(listener)) {}

std::optional<Pose> Mountings::lookup(const std::optional<Pose>& given, const std::string& frame,
                                      const std::string& sensor, std::string* why) const {
  if (given) return given;
  const std::string sensor_frame = withoutSlash(frame);
  if (sensor_frame == base_frame_) return Pose::Identity();
  if (sensor_frame.empty()) {
    *why = "the " + sensor + "'s messages name no frame. Set the parameter " + sensor + "_frame, or base_" + sensor;
    return std::nullopt;
  }
  if (const auto T_base_sensor = transforms_.lookup(base_frame_, sensor_frame)) {
    const std::lock_guard<std::mutex> lock(mutex_);
    looked_up_[sensor_frame] = *T_base_sensor;
    return T_base_sensor;
  }
  const std::vector<std::string> known = transforms_.frames();
  *why = "the mounting of the " + sensor + " is not known: no transform '" + base_frame_ + "' <- '" + sensor_frame +
         "'; " + (known.empty() ? "nothing has come on /tf_static or /tf" : "tf knows the frames " + listed(known)) +
         ". Publish it (rosrun tf2_ros static_transform_publisher x y z qx qy qz qw " + base_frame_ + " " +
         sensor_frame + "), or set the parameter base_" + sensor +
         (known.empty() ? "" : ", or base_frame or " + sensor + "_frame if they have other names here");
  return std::nullopt;
}

std::string Mountings::moved() const {
  constexpr double kTurned = 0.02, kShifted = 0.01;  // [rad], [m]
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const auto& [frame, T_base_sensor] : looked_up_) {
    const auto T_now = transforms_.lookup(base_frame_, frame);
    if (!T_now) continue;
    const double turned = rotationAngle(T_base_sensor.linear(), T_now->linear());
    const double shifted = (T_base_sensor.translation() - T_now->translation()).norm();
    if (turned > kTurned || shifted > kShifted)
      return formatted(
          "'%s' has moved against '%s' by %.1f deg and %.3f m since the map began: name a frame that is "
          "fixed to the sensors as base_frame, or call ~reset",
          frame.c_str(), base_frame_.c_str(), turned / kDegree, shifted);
  }
  return "";
}

}  // namespace air_ground_common::ros_utils
