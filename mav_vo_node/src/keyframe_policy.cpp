#include "keyframe_policy.h"

namespace mav_vo {

namespace {

constexpr double kMovingShare = 0.01;       // of the scene's distance; below, the vehicle hovers
constexpr double kHoverInterval = 3.0;      // a keyframe once the vehicle hovers, so that inertial links stay short [s]
constexpr double kLongHoverInterval = 9.0;  // and while it goes on hovering; the IMU's samples reach back 12 s [s]

}  // namespace

bool KeyframePolicy::due(const visual_frontend::Keyframe& last, double stamp, const Pose& T_map_camera,
                         double scene_distance, int landmarks) const {
  if (visual_frontend::changeOfView(last.T_map_camera, T_map_camera, scene_distance,
                                    {settings_.keyframe_distance, settings_.keyframe_angle}) > 1)
    return true;
  if (landmarks_ > 0 && landmarks < settings_.keyframe_overlap * landmarks_) return true;
  const double elapsed = stamp - last.stamp;
  const double distance = (T_map_camera.translation() - last.T_map_camera.translation()).norm();
  if (elapsed > settings_.keyframe_max_interval && distance > kMovingShare * scene_distance) return true;
  return elapsed > (hovering_ && !moved(last, T_map_camera, scene_distance) ? kLongHoverInterval : kHoverInterval);
}

bool KeyframePolicy::moved(const visual_frontend::Keyframe& since, const Pose& T_map_camera,
                           double scene_distance) const {
  return visual_frontend::changeOfView(since.T_map_camera, T_map_camera, scene_distance,
                                       {kMovingShare, 0.25 * settings_.keyframe_angle}) > 1;
}

}  // namespace mav_vo
