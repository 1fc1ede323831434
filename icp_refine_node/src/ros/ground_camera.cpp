#include "ground_camera.h"

#include <cmath>
#include <utility>

#include "air_ground_common/ros/sensor_input.h"

namespace icp_refine {

GroundCamera::GroundCamera(ros::NodeHandle& handle, const std::string& map_frame, std::function<void(double)> tell)
    : map_frame_(map_frame), tell_(std::move(tell)) {
  subscriber_ = handle.subscribe("ground/rgb/camera_info", 2, &GroundCamera::onInfo, this);
}

void GroundCamera::forget() {
  greatest_ = -std::numeric_limits<double>::infinity();
  tf_.clear();  // what moves; what is on /tf_static stays
}

void GroundCamera::use(const air_ground::MapKeyframes& keyframes) {
  for (const auto& pose : keyframes.poses) raise(pose.position.z);
}

void GroundCamera::raise(double z) {
  constexpr double kStep = 0.01;  // [m] less is not told
  if (!std::isfinite(z) || z < greatest_ + kStep) return;
  greatest_ = z;
  tell_(z);
}

void GroundCamera::onInfo(const sensor_msgs::CameraInfo& msg) {
  const std::string frame = air_ground_common::withoutSlash(msg.header.frame_id);
  if (frame.empty() || !tf_.canTransform(map_frame_, frame, ros::Time(0))) return;
  try {
    raise(tf_.lookupTransform(map_frame_, frame, ros::Time(0)).transform.translation.z);
  } catch (const tf2::TransformException&) {  // gone since it was asked for
  }
}

}  // namespace icp_refine
