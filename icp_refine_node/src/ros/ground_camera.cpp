#include "ground_camera.h"

#include <cmath>
#include <utility>

namespace icp_refine {

GroundCamera::GroundCamera(ros::NodeHandle& handle, const std::string& map_frame, std::function<void(double)> tell)
    : map_frame_(map_frame), tell_(std::move(tell)) {
  subscriber_ = handle.subscribe("ground/rgb/camera_info", 2, &GroundCamera::onInfo, this);
}

void GroundCamera::forget() {
  greatest_ = -std::numeric_limits<double>::infinity();
  transforms_.clear();
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
  if (const auto T_map_camera = transforms_.lookup(map_frame_, msg.header.frame_id))
    raise(T_map_camera->translation().z());
}

}  // namespace icp_refine
