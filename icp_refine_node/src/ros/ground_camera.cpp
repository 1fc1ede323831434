#include "ground_camera.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace icp_refine {

GroundCamera::GroundCamera(ros::NodeHandle& handle, const std::string& map_frame, std::function<void(double)> tell)
    : map_frame_(map_frame), tell_(std::move(tell)) {
  subscriber_ = handle.subscribe("ground/rgb/camera_info", 2, &GroundCamera::onInfo, this);
}

void GroundCamera::revise() {
  transforms_.clear();
  if (!by_keyframes_) greatest_ = -std::numeric_limits<double>::infinity();
}

void GroundCamera::forget() {
  by_keyframes_ = false;
  revise();
}

// They are what the map was made from, and stand where it is now.
void GroundCamera::use(const air_ground::MapKeyframes& keyframes) {
  double greatest = -std::numeric_limits<double>::infinity();
  for (const auto& pose : keyframes.poses)
    if (std::isfinite(pose.position.z)) greatest = std::max(greatest, pose.position.z);
  if (!std::isfinite(greatest)) return;
  by_keyframes_ = true;
  set(greatest);
}

void GroundCamera::set(double z) {
  constexpr double kStep = 0.01;  // [m] less is not told
  if (std::abs(z - greatest_) < kStep) return;
  greatest_ = z;
  tell_(z);
}

void GroundCamera::onInfo(const sensor_msgs::CameraInfo& msg) {
  if (by_keyframes_) return;
  const auto T_map_camera = transforms_.lookup(map_frame_, msg.header.frame_id);
  if (T_map_camera && T_map_camera->translation().z() > greatest_) set(T_map_camera->translation().z());
}

}  // namespace icp_refine
