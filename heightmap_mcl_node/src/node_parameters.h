// The node's parameters, see config/heightmap_mcl.yaml.
#pragma once

#include <string>

#include "air_ground_common/ros/parameters.h"
#include "heightmap_mcl/localizer.h"

namespace heightmap_mcl {

struct NodeSettings {
  LocalizerSettings localizer;
  Prior prior;           ///< empty when the heading is searched
  bool compass = false;  ///< the heading is that of two magnetometers, prior.yaw_sigma their common error
  std::string ground_map_frame, mav_map_frame;  ///< empty: as in the messages
  std::string visual_map_frame;                 ///< of clouds of a map without scale
  double search_radius = 3;                     ///< about initialpose, in Mode::kPaper [m]
  bool publish_tf = false;
  double tf_rate = 10;  ///< [Hz]
  int cloud_queue = 30;
  double odometry_gap = 0.3;  ///< [s]
};

/// Throws ParameterError for a parameter that is out of range, of the wrong type or unknown.
NodeSettings readParameters(air_ground_common::ros_utils::Parameters& parameters);

}  // namespace heightmap_mcl
