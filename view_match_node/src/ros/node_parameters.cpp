#include "node_parameters.h"

#include "air_ground_common/niceness.h"
#include "air_ground_common/parameters.h"

namespace view_match {

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& n) {
  v.about(
      "view_match_node: recognises the MAV's images among the ground robot's keyframes, where both saw the same from "
      "about the same side, and tells from it how their maps lie to each other.");
  v.section("Node");
  v("ground_map_frame", n.ground_map_frame, "frame of ground/map_keyframes");
  v("mav_map_frame", n.mav_map_frame, "frame of mav/posed_image");
  v("visual_map_frame", n.visual_map_frame, "frame of mav/posed_image of a MAV without IMU, in a unit of its own");
  v("niceness", n.niceness, {0, 19}, "", air_ground_common::kNiceness);
  v("interval", n.interval, {0, 3600}, "s", "between two images that are looked up, by their stamps");
  v("converged_interval", n.converged_interval, {0, 3600}, "s", "the same once the estimate is CONVERGED");
  describe(v, n.matcher);
}

}  // namespace view_match
