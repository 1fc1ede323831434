// Parameters of icp_refine_node, read once and checked; config/icp_refine.yaml explains each.
#pragma once

#include <ros/node_handle.h>

#include <string>

#include "icp_refine/alignment_refiner.h"
#include "icp_refine/augmented_map.h"

namespace icp_refine {

struct NodeSettings {
  std::string ground_map_frame, mav_map_frame, chain_file;
  std::string visual_map_frame;  ///< of clouds of a map without scale
  bool publish_tf = true, inverse_tf = false;
  double tf_rate = 10;      ///< [Hz]
  int queue_size = 50;      ///< aerial clouds that may wait for the worker
  double min_period = 0.5;  ///< between refinements [s]
  double map_period = 2;    ///< between augmented maps [s]
  AugmentedMapSettings map;
  RefinerSettings refiner;
};

/// Throws ParameterError.
NodeSettings readParameters(const ros::NodeHandle& private_handle);

/// From `file` or, when that is empty, from the parameter `chain`. Throws ConfigError.
IcpChain readChain(const ros::NodeHandle& private_handle, const std::string& file);

}  // namespace icp_refine
