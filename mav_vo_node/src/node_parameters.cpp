#include "node_parameters.h"

namespace mav_vo {

NodeSettings::NodeSettings() {
  estimator.map_frame = "mav_map";
  estimator.odom_frame = "mav_odom";
  estimator.base_frame = "mav_base_link";
  odometry.synchronous = false;
}

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& n) {
  v.about("mav_vo_node: monocular visual odometry of the MAV with metric scale from its IMU.");
  describe(v, n.estimator);
  n.odometry.use_imu = n.estimator.use_imu;

  v.section("Output");
  v("sparse_cloud_interval", n.sparse_cloud_interval, {0, 60}, "s", "between sparse clouds, at keyframes");
  v("track_image_every", n.track_image_every, {1, 1000}, "", "publish every n-th image with its tracks");

  describe(v, n.odometry);
}

}  // namespace mav_vo
