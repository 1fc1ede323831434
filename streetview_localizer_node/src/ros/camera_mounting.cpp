#include "camera_mounting.h"

#include <ros/init.h>

#include <cmath>

#include "air_ground_common/text.h"

namespace streetview_localizer {
namespace {

constexpr double kTolerance = 0.05;  // between image and transform: a gimbal that turns by 1 rad/s is 3 degrees off [s]
constexpr double kPoll = 0.01;       // [s]

}  // namespace

std::optional<Pose> CameraMounting::at(const ros::Time& stamp, const std::string& camera_frame,
                                       std::string* lacking) const {
  const std::string base = air_ground_common::withoutSlash(settings_.base_frame);
  if (camera_frame == base) return Pose::Identity();
  if (camera_frame.empty()) {
    *lacking = "neither images nor camera_info name a frame (parameter camera_frame)";
    return std::nullopt;
  }
  if (!transforms_.lookup(base, camera_frame)) {
    *lacking = "no transform from '" + camera_frame + "' to '" + base + "' (publish_calibration can give one)";
    return std::nullopt;
  }
  // By the wall clock: that of a paused replay stands still.
  const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(settings_.gravity_wait);
  auto T_base_camera = transforms_.lookup(base, camera_frame, stamp);
  while (!T_base_camera && ros::ok() && ros::WallTime::now() < end) {
    ros::WallDuration(kPoll).sleep();
    T_base_camera = transforms_.lookup(base, camera_frame, stamp);
  }
  if (T_base_camera) return T_base_camera;
  const auto newest = transforms_.newest(base, camera_frame);
  if (newest && std::abs(newest->toSec() - stamp.toSec()) <= kTolerance) return transforms_.lookup(base, camera_frame);
  *lacking = "the transform from '" + camera_frame + "' to '" + base +
             "' is not known at the image's time: publish it on /tf with the images' clock or, where it is fixed, on "
             "/tf_static";
  return std::nullopt;
}

}  // namespace streetview_localizer
