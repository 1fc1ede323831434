// Parameters of ekf_tracker_node; config/ekf_tracker.yaml is their manual.
#pragma once

#include <string>
#include <vector>

#include "air_ground_common/ros/parameters.h"
#include "ekf_tracker/tracker.h"

namespace ekf_tracker {

struct NodeSettings {
  std::string world_frame, map_frame, base_frame, origin_crs;
  std::string autosave;  ///< folder for the trajectory at the end; empty: none
  bool publish_tf, level_increments, magnetometer, gps, barometer;
  double path_step, tilt_stddev, geoid_undulation, odometry_wait, clock_tolerance;
  double declination, magnetometer_stddev, magnetometer_interval;  ///< [rad], [rad], [s]
  double gps_inflation, gps_interval, barometer_stddev, barometer_interval;
  std::vector<double> origin, gps_stddev;
  TrackerSettings tracker;
};

inline NodeSettings readParameters(const ros::NodeHandle& private_handle) {
  air_ground_common::ros_utils::Parameters p(private_handle);
  NodeSettings s;
  s.world_frame = p.text("world_frame", "world");
  s.map_frame = p.text("map_frame", "mav_map");
  s.base_frame = p.text("base_frame", "mav_base_link");
  s.publish_tf = p.flag("publish_tf", true);
  s.autosave = p.text("autosave", "");
  s.path_step = p.number("path_step", 0.2, 0.01, 100);
  s.tilt_stddev = p.number("tilt_stddev", 0.05, 0.001, 1);
  s.origin_crs = p.text("origin_crs", "");
  s.origin = p.numbers("origin", {0, 0, 0}, 3);
  s.geoid_undulation = p.number("geoid_undulation", 0, -120, 100);

  s.level_increments = p.choice("increment_frame", "body", {"body", "level"}) == "body";
  s.odometry_wait = p.number("odometry_wait", 0.5, 0, 60);
  FilterSettings& f = s.tracker.filter;
  f.covariance_factor = p.number("covariance_factor", f.covariance_factor, 0.01, 100);
  f.min_translation_stddev = p.number("min_translation_stddev", f.min_translation_stddev, 1e-6, 1);
  f.min_yaw_stddev = p.number("min_yaw_stddev", f.min_yaw_stddev, 1e-7, 0.1);
  f.metric_scale_stddev = p.number("metric_scale_stddev", f.metric_scale_stddev, 0.001, 0.9);
  f.scale_drift = p.number("scale_drift", f.scale_drift, 0, 0.5);
  f.max_initial_scale_stddev = p.number("max_initial_scale_stddev", f.max_initial_scale_stddev, 0.01, 1);
  f.gap_speed_stddev = p.number("gap_speed_stddev", f.gap_speed_stddev, 0.01, 50);
  f.gap_yaw_rate_stddev = p.number("gap_yaw_rate_stddev", f.gap_yaw_rate_stddev, 0.001, 10);

  f.gate_probability = p.number("gate_probability", f.gate_probability, 0.9, 0.999999);
  f.pairing_time = p.number("pairing_time", f.pairing_time, 1, 3600);
  f.pairing_drift = p.number("pairing_drift", f.pairing_drift, 0.1, 100);
  f.unscaled_start_fixes = p.integer("unscaled_start_fixes", f.unscaled_start_fixes, 2, 20);
  f.recovery_fixes = p.integer("recovery_fixes", f.recovery_fixes, 2, 20);
  f.max_hypotheses = p.integer("max_hypotheses", f.max_hypotheses, 1, 20);
  s.tracker.history = p.number("history", s.tracker.history, 1, 600);
  s.tracker.max_ahead = p.number("max_ahead", s.tracker.max_ahead, 0.1, 600);
  s.clock_tolerance = p.number("clock_tolerance", 0.5, 0, 60);

  constexpr double kDegree = M_PI / 180;
  s.magnetometer = p.flag("magnetometer", false);
  s.declination = kDegree * p.number("declination", 0, -180, 180);
  s.magnetometer_stddev = kDegree * p.number("magnetometer_stddev", 10, 0.1, 90);
  s.magnetometer_interval = p.number("magnetometer_interval", 1, 0, 600);
  s.gps = p.flag("gps", false);
  s.gps_inflation = p.number("gps_inflation", 2, 1, 20);
  s.gps_stddev = p.numbers("gps_stddev", {8, 8, 12}, 3);
  for (const double stddev : s.gps_stddev)
    if (!(stddev > 0))
      throw air_ground_common::ros_utils::ParameterError("parameter gps_stddev must hold 3 positive numbers");
  s.gps_interval = p.number("gps_interval", 10, 0, 600);
  s.barometer = p.flag("barometer", false);
  s.barometer_stddev = p.number("barometer_stddev", 0.5, 0.01, 50);
  f.barometer_drift = p.number("barometer_drift", f.barometer_drift, 0, 10);
  s.barometer_interval = p.number("barometer_interval", 1, 0, 600);
  p.finish();
  if (s.gps && s.origin_crs.empty())
    throw air_ground_common::ros_utils::ParameterError(
        "parameter gps = true needs origin_crs and origin, which say where the world frame lies");
  return s;
}

}  // namespace ekf_tracker
