// Parameters of rgbd_slam_node.
#pragma once

#include "air_ground_common/parameters.h"
#include "air_ground_common/ros/estimator_shell.h"
#include "depth_input.h"
#include "rgbd_slam/slam.h"

namespace rgbd_slam {

struct NodeSettings {
  NodeSettings();

  SlamSettings slam;
  air_ground_common::ros_utils::EstimatorSettings estimator;
  DepthInputSettings depth;
  bool use_depth_stamps = true;
  double cloud_interval = 2.0, cloud_bandwidth = 2.0;  ///< [s], [MB/s]

  void validate() const { slam.validate(); }
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace rgbd_slam
