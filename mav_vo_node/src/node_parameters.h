// Parameters of mav_vo_node, read once and checked; config/mav_vo.yaml explains each.
#pragma once

#include <ros/node_handle.h>

#include <optional>
#include <string>

#include "mav_vo/odometry.h"

namespace mav_vo {

struct NodeSettings {
  OdometrySettings odometry;
  std::string map_frame, odom_frame, base_frame;
  std::string camera_frame, imu_frame;            ///< empty: as the messages say
  std::optional<Pose> T_base_camera, T_base_imu;  ///< instead of tf
  bool publish_tf = true;
  double transform_timeout = 5.0;      ///< wall clock [s]
  double imu_wait = 0.5;               ///< an image waits so long for the IMU's samples up to its stamp [s of data]
  double sparse_cloud_interval = 1.0;  ///< [s]
  int track_image_every = 2;
  int queue_size = 400;
};

/// Throws ParameterError.
NodeSettings readParameters(const ros::NodeHandle& private_handle);

}  // namespace mav_vo
