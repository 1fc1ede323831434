#include "camera_mounting.h"

#include <ros/init.h>

#include <cmath>

#include "air_ground_common/ros/conversions.h"
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
  const auto lookup = [&](const ros::Time& time) { return tf_.lookupTransform(base, camera_frame, time); };
  try {
    // By the wall clock: that of a paused replay stands still.
    const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(settings_.gravity_wait);
    lookup(ros::Time(0));  // throws where the frames are not connected: no wait
    while (!tf_.canTransform(base, camera_frame, stamp) && ros::ok() && ros::WallTime::now() < end)
      ros::WallDuration(kPoll).sleep();
    if (tf_.canTransform(base, camera_frame, stamp))
      return air_ground_common::ros_utils::fromMsg(lookup(stamp).transform);
    const geometry_msgs::TransformStamped newest = lookup(ros::Time(0));
    if (std::abs(newest.header.stamp.toSec() - stamp.toSec()) <= kTolerance)
      return air_ground_common::ros_utils::fromMsg(newest.transform);
    *lacking = "the transform from '" + camera_frame + "' to '" + base +
               "' is not known at the image's time: publish it on /tf with the images' clock or, where it is fixed, on "
               "/tf_static";
  } catch (const std::exception&) {
    *lacking = "no transform from '" + camera_frame + "' to '" + base + "' (publish_calibration can give one)";
  }
  return std::nullopt;
}

}  // namespace streetview_localizer
