// Parameters of rgbd_slam_node, read once and checked; config/rgbd_slam.yaml explains each.
#pragma once

#include <ros/node_handle.h>

#include "air_ground_common/ros/estimator_shell.h"
#include "depth_input.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

struct NodeSettings {
  SlamSettings slam;
  air_ground_common::ros_utils::EstimatorSettings estimator;
  DepthInputSettings depth;
  double cloud_interval = 2.0;  ///< [s]
};

/// Throws ParameterError.
NodeSettings readParameters(const ros::NodeHandle& private_handle);

}  // namespace rgbd_slam
