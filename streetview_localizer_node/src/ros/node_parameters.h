// Parameters of streetview_localizer_node.
#pragma once

#include <cmath>
#include <string>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

struct NodeSettings {
  std::string database, world_frame = "world", base_frame = "mav_base_link", camera_frame, image_transport = "raw";
  bool use_prior = true, use_gravity = true, keep_index = true, display = true;
  int prior_misses = 3;
  int niceness = 5;  ///< see giveWay
  double min_period = 0, prior_max_age = 1, prior_speed = 3, gravity_max_age = 0.1, gravity_wait = 0.3,
         gravity_stddev = 1.15 * M_PI / 180;
  double model_spacing = 0.2;
  int model_max_points = 400000, display_width = 480, cameras_shown = 500;
  DatabaseLoadOptions load;
  StreetviewLocalizerSettings localizer;

  /// Throws ParameterError.
  void validate() const;
};

void describe(air_ground_common::ParameterVisitor& visitor, NodeSettings& settings);

}  // namespace streetview_localizer
