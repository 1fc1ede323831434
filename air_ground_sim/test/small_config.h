// A world of one cluster and a short flight, quick to render.
#pragma once

#include "air_ground_sim/config.h"

namespace air_ground_sim {

inline SimConfig smallConfig() {
  SimConfig c = SimConfig::defaults();
  c.world.texel = 0.03;
  c.world.clusters = {ClusterConfig()};
  c.lane.points = {{2.5, -1.2}, {2.7, 0.2}, {2.3, 1.6}, {1.2, 2.5}, {-0.3, 2.7}};
  c.flight.duration = 8;
  c.mav_camera.samples = c.ground_camera.samples = 2;
  return c;
}

}  // namespace air_ground_sim
