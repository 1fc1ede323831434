// Parameters of mav_vo_node.
#pragma once

#include <string>

#include "air_ground_common/parameters.h"
#include "air_ground_common/ros/estimator_shell.h"
#include "mav_vo/odometry.h"

namespace mav_vo {

struct NodeSettings {
  NodeSettings();

  OdometrySettings odometry;
  air_ground_common::ros_utils::EstimatorSettings estimator;
  std::string visual_frame = "mav_visual_map";
  double sparse_cloud_interval = 1.0;
  int track_image_every = 2;
  double posed_image_spacing = 0.02;
  int posed_image_quality = 0;

  void validate() const { odometry.validate(); }
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace mav_vo
