// How high the camera that makes the ground map stands: from its frame and tf, and where its keyframes stand.
#pragma once

#include <air_ground/MapKeyframes.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>

#include <functional>
#include <limits>
#include <string>

#include "air_ground_common/ros/transform_buffer.h"

namespace icp_refine {

class GroundCamera {
 public:
  /// `tell` is called, by the thread that spins, with the greatest z in `map_frame` [m], whenever it changes: of the
  /// newest keyframes; until some come, of what tf has told so far.
  GroundCamera(ros::NodeHandle& handle, const std::string& map_frame, std::function<void(double)> tell);

  /// Keyframes of the present map: tf may not lead to the camera (another node owns the robot's edges, or a parameter
  /// tells the mounting). Poses that are not finite are left out.
  void use(const air_ground::MapKeyframes& keyframes);

  /// The map was corrected as a whole: tf showed the camera in the map as it was.
  void revise();
  /// Another ground map begins.
  void forget();

 private:
  void onInfo(const sensor_msgs::CameraInfo& msg);
  void set(double z);

  const std::string map_frame_;
  std::function<void(double)> tell_;
  double greatest_ = -std::numeric_limits<double>::infinity();
  bool by_keyframes_ = false;
  air_ground_common::ros_utils::TransformBuffer transforms_;
  ros::Subscriber subscriber_;
};

}  // namespace icp_refine
