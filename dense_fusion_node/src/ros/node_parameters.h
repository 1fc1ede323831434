// Parameters of dense_fusion_node.
#pragma once

#include <string>

#include "dense_fusion/dense_mapper.h"

namespace dense_fusion {

struct NodeSettings {
  MapperSettings mapper;
  std::string visual_map_frame = "mav_visual_map";
  std::string autosave;  ///< folder for the map at the end; empty: none
  int queue_size = 1200;
  double max_latency = 5;     ///< images further behind the newest are dropped; 0: none [s of data]
  bool player_waits = false;  ///< the player of a replay is held while the node lags: nothing is dropped
  double flush_timeout = 4.0, service_timeout = 120, map_cell = 0.02;
  int map_max_points = 5000000;
  int niceness = 5;  ///< see giveWay

  void validate() const { mapper.validate(); }
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace dense_fusion
