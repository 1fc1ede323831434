// Parameters of mav_vo_node, read once and checked; config/mav_vo.yaml explains each.
#pragma once

#include <ros/node_handle.h>

#include <string>

#include "air_ground_common/ros/estimator_shell.h"
#include "mav_vo/odometry.h"

namespace mav_vo {

struct NodeSettings {
  OdometrySettings odometry;
  air_ground_common::ros_utils::EstimatorSettings estimator;
  std::string visual_frame;            ///< of posed images and sparse clouds of a map in its own unit
  double sparse_cloud_interval = 1.0;  ///< [s]
  int track_image_every = 2;
};

/// Throws ParameterError.
NodeSettings readParameters(const ros::NodeHandle& private_handle);

}  // namespace mav_vo
