// Parameters of view_match_node.
#pragma once

#include <string>

#include "view_match/view_matcher.h"

namespace view_match {

struct NodeSettings {
  std::string ground_map_frame = "ground_map", mav_map_frame = "mav_map", visual_map_frame = "mav_visual_map";
  double interval = 0.3, converged_interval = 2;  ///< [s] of the images' stamps
  MatcherSettings matcher;
  int niceness = 10;  ///< see giveWay

  void validate() const { matcher.validate(); }
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace view_match
