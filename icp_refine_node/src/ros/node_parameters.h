// Parameters of icp_refine_node.
#pragma once

#include <string>

#include "icp_refine/alignment_refiner.h"
#include "icp_refine/augmented_map.h"

namespace icp_refine {

struct NodeSettings {
  std::string ground_map_frame = "ground_map", mav_map_frame = "mav_map", chain_file;
  std::string visual_map_frame = "mav_visual_map";
  bool publish_tf = true, inverse_tf = false;
  double tf_rate = 10;
  std::string autosave;  ///< folder for the augmented map at the end; empty: none
  int queue_size = 50;
  double min_period = 0.5, map_period = 2;
  AugmentedMapSettings map;
  RefinerSettings refiner;

  void validate() const {}
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace icp_refine
