// Where the camera sits on the base, at the time of an image.
#pragma once

#include <ros/time.h>

#include <optional>
#include <string>

#include "air_ground_common/ros/transform_buffer.h"
#include "node_parameters.h"

namespace streetview_localizer {

/// From tf. Any thread may ask.
class CameraMounting {
 public:
  explicit CameraMounting(const NodeSettings& settings) : settings_(settings) {}

  /// T_base_camera. A camera on a gimbal turns between images: its transform of this time may come a little later than
  /// the image, and is waited for. Empty while it is not known, with the reason in `lacking`.
  std::optional<Pose> at(const ros::Time& stamp, const std::string& camera_frame, std::string* lacking) const;
  /// Forgets moving edges; fixed ones stay.
  void clear() { transforms_.clear(); }

 private:
  const NodeSettings& settings_;
  air_ground_common::ros_utils::TransformBuffer transforms_;
};

}  // namespace streetview_localizer
