#include "node_parameters.h"

namespace rgbd_slam {

NodeSettings::NodeSettings() {
  estimator.map_frame = "ground_map";
  estimator.odom_frame = "ground_odom";
  estimator.base_frame = "ground_base_link";
  estimator.queue_size = 300;
  slam.synchronous = false;
}

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& n) {
  v.about("rgbd_slam_node: RGB-D SLAM of the ground robot and the dense ground map.");
  describe(v, n.estimator);
  v("sync_tolerance", n.estimator.sync_tolerance, {0, 1}, "s", "largest difference of the stamps of colour and depth");
  v("depth_transport", n.estimator.depth_transport,
    "compressed: PNG on <topic>/compressedDepth (launch argument ground_depth_transport)", {"raw", "compressed"});
  v("depth_unit", n.depth.unit, {1e-6, 1}, "m", "a step of 16UC1 depth images (launch argument ground_depth_unit)");
  v("depth_registered", n.depth.registered,
    "false: depth is registered to colour here, by ground/depth/camera_info and the mounting (launch argument)");
  v("depth_frame", n.depth.frame,
    "optical frame of the depth camera where that is not registered; \"\" = as its camera_info says");
  v("use_depth_stamps", n.use_depth_stamps,
    "depth is carried from its own stamp to that of its colour image, as the camera moves; false: it counts as taken "
    "at once with that (a driver that stamps depth on arrival)");
  v("base_depth", n.depth.T_base_depth, "x y z qx qy qz qw of the depth camera in base_link [m]; all 0 = from tf");

  v.section("Output");
  v("cloud_interval", n.cloud_interval, {0.1, 600}, "s",
    "between clouds, while the map grows; a corrected map is sent at once");
  v("cloud_bandwidth", n.cloud_bandwidth, {0.001, 10000}, "MB/s",
    "of the clouds, to each subscriber: one that takes longer than cloud_interval comes so much less often (16 bytes a "
    "point)");

  describe(v, n.slam);
}

}  // namespace rgbd_slam
