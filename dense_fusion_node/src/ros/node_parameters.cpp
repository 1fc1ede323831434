#include "node_parameters.h"

#include "air_ground_common/niceness.h"
#include "air_ground_common/parameters.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/ros/parameters.h"

namespace dense_fusion {

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& s) {
  v.about(
      "dense_fusion_node: dense clouds from posed images. Figures of the paper: Forster, Pizzoli, Scaramuzza, IROS "
      "2013, sections V, VIII-B.");
  v.section("Node");
  v("visual_map_frame", s.visual_map_frame,
    "posed images in it are of a map without scale, which keeps a unit of its own");
  v("autosave", s.autosave, air_ground_common::ros_utils::kAutosave);
  v("niceness", s.niceness, {0, 19}, "", air_ground_common::kNiceness);
  v("queue_size", s.queue_size, {10, 10000}, "",
    "posed images that may wait for the worker (512 MB of them at the most); the oldest are dropped, and counted, "
    "beyond it");
  v("max_latency", s.max_latency, {0, 600}, "s",
    "waiting images further behind the newest are dropped, oldest first; 0 = none; replay.launch drops none "
    "(player_waits)");
  v("player_waits", s.player_waits, air_ground_common::ros_utils::kPlayerWaits);
  v("flush_timeout", s.flush_timeout, {0, 3600}, "s",
    "wall time without input after which the depth maps at hand are fused; 0: only when asked (~flush)");
  v("service_timeout", s.service_timeout, {0.01, 3600}, "s",
    "wall time that ~flush and ~save_map wait for waiting images and a fusion; then they fail");
  v("map_cell", s.map_cell, {0.001, 1}, "m", "~save_map keeps one point in each cell of this size");
  v("map_max_points", s.map_max_points, {1000, 100000000}, "",
    "of that map, about 80 bytes each; beyond it the cells double, which is counted");

  describe(v, s.mapper);
}

}  // namespace dense_fusion
