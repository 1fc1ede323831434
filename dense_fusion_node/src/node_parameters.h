// The node's parameters, read from its private namespace; config/dense_fusion.yaml documents them.
#pragma once

#include <ros/node_handle.h>

#include <string>

#include "dense_fusion/dense_mapper.h"

namespace dense_fusion {

struct NodeSettings {
  MapperSettings mapper;
  std::string visual_frame;      ///< posed images in it are in a unit of their own, which their map keeps
  int queue_size = 400;          ///< images waiting for the worker; older ones are dropped beyond it
  double flush_timeout = 4.0;    ///< wall time without input after which what there is gets fused [s]; 0: never
  double service_timeout = 120;  ///< wall time that ~flush and ~save_map wait for the worker [s]
  double map_cell = 0.02;        ///< thinning of the map that ~save_map writes [m]
  int map_max_points = 5000000;  ///< of that map; beyond it the cells double
};

/// Throws air_ground_common::ros_utils::ParameterError with a line that names the parameter.
NodeSettings readParameters(const ros::NodeHandle& private_handle);

}  // namespace dense_fusion
