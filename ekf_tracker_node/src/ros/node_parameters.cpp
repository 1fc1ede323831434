#include "node_parameters.h"

#include "air_ground_common/parameters.h"
#include "air_ground_common/ros/file_services.h"
#include "air_ground_common/text.h"

namespace ekf_tracker {
namespace {

constexpr double kUnknown = -1000;  // what a user writes for a number that is not known

// A number in `range` or, where it is not known, kUnknown.
void describeKnown(air_ground_common::ParameterVisitor& v, const char* name, std::optional<double>& field,
                   air_ground_common::ParameterRange range, const char* unit, const char* text) {
  double value = field.value_or(kUnknown);
  v(name, value, {kUnknown, range.max}, unit, text);
  if (value > kUnknown && value < range.min)
    throw air_ground_common::ParameterError(
        std::string("parameter ") + name + " = " + air_ground_common::toString(&value) +
        air_ground_common::formatted(" must lie in [%g, %g] %s, or be %g where it is not known", range.min, range.max,
                                     unit, kUnknown));
  field = value < range.min ? std::nullopt : std::make_optional(value);
}

void describeDeclination(air_ground_common::ParameterVisitor& v, NodeSettings& s) {
  std::optional<double> degrees;
  if (s.declination) degrees = *s.declination * 180 / M_PI;
  describeKnown(v, "declination", degrees, {-180, 180}, "deg",
                "of magnetic from true north, east positive, at least -180; 3.2 in Zurich (2024). -1000: not known; "
                "then no reading of the magnetometer is used");
  s.declination = degrees ? std::make_optional(*degrees * M_PI / 180) : std::nullopt;
}

}  // namespace

void describe(air_ground_common::ParameterVisitor& v, NodeSettings& s) {
  v.about("ekf_tracker_node: position and heading in the city.");
  v.section("Frames and output");
  v("world_frame", s.world_frame, "local east-north-up frame; fixes must be given in it");
  v("map_frame", s.map_frame, "the visual odometry's gravity-aligned map");
  v("base_frame", s.base_frame, "");
  v("publish_tf", s.publish_tf, "world -> mav_map, so that world -> mav_base_link is the tracked pose");
  v("autosave", s.autosave, air_ground_common::ros_utils::kAutosave);
  v("path_step", s.path_step, {0.01, 100}, "m",
    "tracked/path gains a pose after this distance; doubled whenever it holds 5000");
  v("tilt_stddev", s.tilt_stddev, {0.001, 1}, "rad",
    "roll and pitch in the published covariance, at least; they come from mav/odometry, without it from the fixes and "
    "the accelerometer, and the deviation is theirs where it is larger");

  v.section("Where `world` lies (for tracked/geodetic and gps/fix)");
  v("origin_crs", s.origin_crs,
    "e.g. EPSG:2056 (Swiss LV95), EPSG:32632 (UTM 32N); empty: no geodetic output, GPS is not used");
  v("origin", s.origin, {-1e9, 1e9}, "m", "easting, northing, height of the world's origin in that system");
  describeKnown(v, "geoid_undulation", s.geoid_undulation, {-120, 100}, "m",  // on Earth from -107 to 86
                "ellipsoidal height minus the height used in `origin`, at least -120; 47.3 in Zurich, 0 where `origin` "
                "is above the ellipsoid. -1000: not known; then GPS gives no height, and tracked/geodetic has the "
                "height of `origin`'s datum");

  v.section("Visual odometry");
  v.choice("increment_frame", s.level_increments, {{"body", true}, {"level", false}},
           "body: relative_pose is in the tilted body, levelled here; level: it is level already");
  v("odometry_wait", s.odometry_wait, {0, 60}, "s",
    "an increment waits so long (wall time) for mav/odometry of its stamp, for tilt and tf; one that is not metric "
    "only while mav/odometry comes. Without it fixes and accelerometer give the tilt. 0: none is used, roll and pitch "
    "are neglected as in the paper, and there is no tf");
  v("accel_topic", s.accel_topic,
    "sensor_msgs/Imu of an accelerometer that has a topic of its own (launch argument mav_imu_accel); \"\" = in the "
    "IMU's messages");
  v("clock_tolerance", s.clock_tolerance, {0, 60}, "s",
    "a fix or an increment stamped this far ahead of the ROS clock is refused");
  describe(v, s.tracker);

  v.section("Magnetometer (mav/imu/mag)");
  v("magnetometer", s.magnetometer, "");
  describeDeclination(v, s);
  v.degrees("magnetometer_stddev", s.magnetometer_stddev, {0.1, 90},
            "of the heading; buildings and motors bend the field for seconds on end");
  v("magnetometer_interval", s.magnetometer_interval, {0, 600}, "s",
    "at most one reading in this time, since their errors last");

  v.section("GPS (gps/fix)");
  v("gps", s.gps, "");
  v("gps_inflation", s.gps_inflation, {1, 20}, "",
    "multiplies the standard deviations stated in the message: street canyons");
  v("gps_stddev", s.gps_stddev, {1e-3, 1e3}, "m",
    "east, north, up where the message states none, and the least ever used");
  v("gps_interval", s.gps_interval, {0, 600}, "s", "its errors last for tens of seconds: at most one in this time");

  v.section("Barometer (barometer, Pa)");
  v("barometer", s.barometer, "");
  v("barometer_stddev", s.barometer_stddev, {0.01, 50}, "m", "of a height");
  v("barometer_interval", s.barometer_interval, {0, 600}, "s", "");
}

void NodeSettings::validate() const {
  check(tracker);
  if (gps && origin_crs.empty())
    throw air_ground_common::ParameterError(
        "parameter gps = true needs origin_crs and origin, which say where the world frame lies");
}

}  // namespace ekf_tracker
