// Parameters of heightmap_mcl_node.
#pragma once

#include <string>

#include "heightmap_mcl/localizer_settings.h"

namespace heightmap_mcl {

struct NodeSettings {
  NodeSettings() { prior.yaw_sigma = 0.17; }

  HeightMapLocalizerSettings localizer;  ///< as the user sets them; see localizerSettings
  Prior prior;                           ///< empty when the heading is searched
  bool compass = false;  ///< the heading is that of two magnetometers, prior.yaw_sigma their common error
  std::string ground_map_frame, mav_map_frame, visual_map_frame = "mav_visual_map";
  double search_radius = 3;
  bool publish_tf = false;
  double tf_rate = 10;
  int cloud_queue = 30;
  double odometry_gap = 0.3;
  int niceness = 10;  ///< see giveWay

  /// As `mode` makes them.
  HeightMapLocalizerSettings localizerSettings() const {
    return localizer.mode == Mode::kPaper ? paperSettings(localizer) : localizer;
  }
  void validate() const { heightmap_mcl::validate(localizerSettings()); }
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace heightmap_mcl
