// Parameters of rgbd_slam_node, read once and checked; config/rgbd_slam.yaml explains each.
#pragma once

#include <ros/node_handle.h>

#include <optional>
#include <string>

#include "rgbd_slam/slam.h"

namespace rgbd_slam {

struct NodeSettings {
  SlamSettings slam;
  std::string map_frame, odom_frame, base_frame;
  std::string camera_frame, imu_frame;            ///< empty: as the messages say
  std::optional<Pose> T_base_camera, T_base_imu;  ///< instead of tf
  bool publish_tf = true;
  bool use_imu = true;
  double transform_timeout = 5.0;  ///< wall clock [s]
  double sync_tolerance = 0.02;    ///< [s]
  double imu_wait = 0.5;           ///< [s of data]
  double cloud_interval = 2.0;     ///< [s]
  int queue_size = 300;
};

/// Throws ParameterError.
NodeSettings readParameters(const ros::NodeHandle& private_handle);

}  // namespace rgbd_slam
