#include "air_ground_common/ros/mountings.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/sensor_input.h"

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

Mountings::Mountings(const std::string& base_frame, TransformInput::Listener listener)
    : base_frame_(withoutSlash(base_frame)), transforms_(buffer_, std::move(listener)) {}

std::optional<Pose> Mountings::lookup(const std::optional<Pose>& given, const std::string& frame,
                                      const std::string& sensor, std::string* why) const {
  if (given) return given;
  const std::string sensor_frame = withoutSlash(frame);
  if (sensor_frame == base_frame_) return Pose::Identity();
  if (sensor_frame.empty()) {
    *why = "the " + sensor + "'s messages name no frame. Set the parameter " + sensor + "_frame, or base_" + sensor;
    return std::nullopt;
  }
  if (buffer_.canTransform(base_frame_, sensor_frame, ros::Time(0)))
    return fromMsg(buffer_.lookupTransform(base_frame_, sensor_frame, ros::Time(0)).transform);
  std::vector<std::string> known;
  buffer_._getFrameStrings(known);
  *why = "the mounting of the " + sensor + " is not known: no transform '" + base_frame_ + "' <- '" + sensor_frame +
         "'; " + (known.empty() ? "nothing has come on /tf_static or /tf" : "tf knows the frames " + listed(known)) +
         ". Publish it (rosrun tf2_ros static_transform_publisher x y z qx qy qz qw " + base_frame_ + " " +
         sensor_frame + "), or set the parameter base_" + sensor +
         (known.empty() ? "" : ", or base_frame or " + sensor + "_frame if they have other names here");
  return std::nullopt;
}

}  // namespace air_ground_common::ros_utils
