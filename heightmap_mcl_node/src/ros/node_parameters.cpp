#include "node_parameters.h"

#include <cmath>

#include "air_ground_common/niceness.h"
#include "air_ground_common/parameters.h"

namespace heightmap_mcl {

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& n) {
  v.about("heightmap_mcl_node: global localization of the MAV in the ground robot's map (Forster 2013, section VI).");
  v.section("Frames and topics");
  v("ground_map_frame", n.ground_map_frame,
    "frame of ground/map_cloud; empty: the frame of the first cloud. Clouds in another frame are dropped");  // , ""
  v("mav_map_frame", n.mav_map_frame, "frame of mav/dense_cloud; empty: as above");                          // , ""
  v("visual_map_frame", n.visual_map_frame, "frame of mav/dense_cloud of a MAV without IMU, in a unit of its own");
  v("publish_tf", n.publish_tf,
    "ground map -> MAV map on /tf while CONVERGED; leave off when icp_refine_node publishes it");
  v("tf_rate", n.tf_rate, {0.1, 1000}, "Hz", "of that transform, stamped with the clock");
  v("niceness", n.niceness, {0, 19}, "", air_ground_common::kNiceness);
  v("cloud_queue", n.cloud_queue, {1, 10000}, "",
    "aerial clouds that may wait for their search; the oldest is beyond that kept (and counted) among those that the "
    "MAV has left behind");
  v("odometry_gap", n.odometry_gap, {0.01, 10.0}, "s",
    "longest gap in mav/odometry over which the pose at a cloud's stamp is interpolated; a cloud waits 0.3 s for it "
    "(wall time)");

  v.section("Prior");
  enum class Heading { kSearch, kPrior, kCompass };
  Heading heading = n.compass ? Heading::kCompass : n.prior.yaw ? Heading::kPrior : Heading::kSearch;
  v.choice("heading_mode", heading,
           {{"search", Heading::kSearch}, {"prior", Heading::kPrior}, {"compass", Heading::kCompass}},
           "search: all headings; prior: a known mounting gives the heading; compass: the magnetometers of both robots "
           "do (mav/imu/mag, ground/imu/mag; all headings until both have said 20 times where north is)");
  double yaw = n.prior.yaw.value_or(0);
  v("heading_prior", yaw, {-M_PI, M_PI}, "rad",
    "heading of the MAV map's x axis in the ground map, for heading_mode prior");
  v("heading_sigma", n.prior.yaw_sigma, {0.002, M_PI}, "rad",
    "its standard deviation; +-3 sigma is searched. compass: of what the readings' scatter does not show, e.g. a field "
    "that bends between the robots");
  n.compass = heading == Heading::kCompass;
  n.prior.yaw.reset();
  if (heading == Heading::kPrior) n.prior.yaw = yaw;
  v("search_radius", n.search_radius, {0.5, 100}, "m",
    "mode paper: the MAV is looked for so near to initialpose; everywhere while none was given");

  v.section("Method");
  describe(v, n.localizer);
}

}  // namespace heightmap_mcl
