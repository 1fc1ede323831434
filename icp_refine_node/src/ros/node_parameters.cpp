#include "node_parameters.h"

#include "air_ground_common/parameters.h"
#include "air_ground_common/ros/file_services.h"

namespace icp_refine {
void describe(air_ground_common::ParameterVisitor& v, NodeSettings& s) {
  v.about(
      "icp_refine_node: refines the coarse alignment of the MAV's map with the ground map by ICP, and merges both "
      "maps.");
  v.section("Node");
  v("ground_map_frame", s.ground_map_frame, "frame of ground/map_cloud; parent in tf");
  v("mav_map_frame", s.mav_map_frame, "frame of mav/dense_cloud; child in tf");
  v("visual_map_frame", s.visual_map_frame, "frame of mav/dense_cloud of a MAV without IMU, in a unit of its own");
  v("publish_tf", s.publish_tf, "false: another node owns ground_map -> mav_map");
  v("inverse_tf", s.inverse_tf,
    "true: publishes mav_map -> ground_map instead (when something else is mav_map's parent)");
  v("tf_rate", s.tf_rate, {0.1, 1000}, "Hz", "stamped with the clock; nothing before the first CONVERGED");
  v("autosave", s.autosave, air_ground_common::ros_utils::kAutosave);
  v("queue_size", s.queue_size, {1, 10000}, "",
    "aerial clouds that may wait for a refinement to end; the oldest are dropped, and counted");
  v("min_period", s.min_period, {0, 3600}, "s",
    "wall time from the end of a refinement to the next, of dense clouds and of what else changes each: bounds the "
    "load");
  v("chain_file", s.chain_file, "instead of `chain` (below), a file that holds the same map");
  v.others("chain");

  v.section("Augmented map");
  v("augmented_map/leaf", s.map.leaf, {0.001, 10}, "m", "aerial points: one a voxel of this edge");
  v("augmented_map/min_points", s.map.min_points, {1, 1000000}, "", "aerial voxels with fewer points are left out");
  v("augmented_map/period", s.map_period, {0, 3600}, "s",
    "wall time between two published maps; none without a subscriber");
  v("augmented_map/max_points", s.map.max_voxels, {1000, 100000000}, "", "aerial voxels; beyond that leaf is doubled");
  v("augmented_map/fill_only", s.map.fill_only, "true: aerial points only where the ground robot saw nothing");
  v.choice("augmented_map/ground_color", s.map.ground_red, {{"red", true}, {"original", false}}, "red as in the paper");

  describe(v, s.refiner);
}

}  // namespace icp_refine
