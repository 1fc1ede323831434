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
  v("visual_map_frame", n.visual_frame,
    "without IMU: frame of posed images and sparse clouds, in a unit that the map keeps");
  v("sparse_cloud_interval", n.sparse_cloud_interval, {0, 60}, "s", "between sparse clouds, at keyframes");
  v("posed_image_spacing", n.posed_image_spacing, {0, 10}, "m",
    "images nearer than this to the last one sent, turned by less than 0.05 rad and not 0.2 s later are not sent; "
    "without "
    "scale as if the scene were 2 m away; 0: all are");
  v("posed_image_quality", n.posed_image_quality, {0, 100}, "",
    "of their JPEG, for a radio link: at 90 a fifth to two fifths of the bytes; 0: uncompressed");
  v("track_image_every", n.track_image_every, {1, 1000}, "", "publish every n-th image with its tracks");

  describe(v, n.odometry);
}

}  // namespace mav_vo
